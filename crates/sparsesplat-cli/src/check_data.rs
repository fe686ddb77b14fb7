//! `check-data`: what a data set is, and what is wrong with it.

use crate::arguments::{Common, positive};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::{Outputs, named};
use crate::progress::Progress;
use crate::summary::{memory_line, print_line};
use check_data::{CheckReport, CheckSettings, CheckStage, Finding, Severity, check_data, layout_html};
use clap::Args;
use evaluate::{Recipe, peak_rss_bytes};
use scene_windows::Dropped;
use serde::Serialize;
use std::path::{Path, PathBuf};
use view_data::{Dataset, Format, open_all};

/// Describe a data set and find mistakes in it
///
/// Every picture and depth file is decoded. Photographs are matched without the poses. The matches are compared with the poses as read and with
/// the usual misreadings (other axes, inverted matrices, a wrong focal length), which tells a wrong convention from bad data. Depth is compared
/// with both. Scale, range, overlap and the layout of the cameras are measured.
///
/// INPUT may also be a scene (.ply, .compressed.ply, .spz, .splat, .glb): its format, extent, and Gaussians that cannot be drawn are told.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  \
    sparsesplat check-data data/fox\n  \
    sparsesplat check-data data/fox --report fox.html        also draw the layout of the cameras\n  \
    sparsesplat check-data Replica --pairs 40                check every scene below a folder\n  \
    sparsesplat check-data scene.spz                         describe a scene of Gaussians\n\n\
    Exit codes: 0 no errors, 1 errors were found, 2 there is no data set to check.")]
pub(crate) struct Arguments {
    /// Folder of a data set, the file that describes it, a folder of several data sets, or a scene of Gaussians
    input: PathBuf,
    /// Layout of the data set: nerfstudio, colmap, replica, tum, scannet, chunk, dl3dv or re10k [default: recognised by its files]
    #[arg(long, value_name = "LAYOUT")]
    format: Option<Format>,
    /// Largest number of pairs of photographs to match per scene
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = CheckSettings::default().pairs)]
    pairs: usize,
    /// Seed of the matching
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Write a report: cameras from above and from the side, overlap, findings, pictures; with several scenes, one file each
    #[arg(long, value_name = "PATH")]
    report: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<C> {
    recipe: Recipe<C>,
    scenes: Vec<CheckReport>,
    /// Scenes that cannot be read.
    dropped: Vec<Dropped>,
    peak_rss_bytes: Option<u64>,
}

/// The settings in the recipe.
#[derive(Serialize)]
struct Settings {
    pairs: usize,
    corners: usize,
    seed: u64,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    if arguments.input.is_file() && splat_formats::Format::of_path(&arguments.input).is_some() {
        return crate::check_scene::run(&arguments.input, common);
    }
    let outputs = Outputs::of(common).with("--report", arguments.report.as_ref()).check()?;
    let found = open_all(&arguments.input, arguments.format).or_input()?;
    for scene in &found.scenes {
        outputs.spare(scene.files().iter().map(PathBuf::as_path))?;
    }
    let settings = CheckSettings { pairs: arguments.pairs, seed: arguments.seed, ..CheckSettings::default() };
    let several = found.scenes.len() > 1;
    let mut reports: Vec<CheckReport> = Vec::with_capacity(found.scenes.len());
    for scene in &found.scenes {
        let report = check(scene, &settings)?;
        show(&report);
        if let Some(path) = &arguments.report {
            let path = if several { of_scene(path, &report.name) } else { path.clone() };
            output::write_text(&path, &layout_html(&report))?;
            print_line(&format!("report     {}", named(&path)));
        }
        reports.push(report);
    }
    for dropped in &found.dropped {
        print_line(&format!("error   {}: cannot be read: {}", dropped.key, dropped.reason));
    }
    print_line(&memory_line(peak_rss_bytes()));
    let errors =
        reports.iter().map(|report| report.count(Severity::Error)).sum::<usize>() + found.dropped.len();
    if let Some(path) = &common.json {
        let config = Settings { pairs: settings.pairs, corners: settings.corners, seed: settings.seed };
        let dropped = found.dropped.into_iter();
        let record = Record {
            recipe: crate::recipe(arguments.seed, config),
            scenes: reports,
            dropped: dropped
                .map(|entry| Dropped { name: entry.key, reason: entry.reason, failed: true })
                .collect(),
            peak_rss_bytes: peak_rss_bytes(),
        };
        output::write_json(path, &record)?;
    }
    match errors {
        0 => Ok(()),
        1 => Err(Failure::work("an error was found in the data")),
        n => Err(Failure::work(format!("{n} errors were found in the data"))),
    }
}

fn check(scene: &Dataset, settings: &CheckSettings) -> Outcome<CheckReport> {
    // Several lengths in turn: the line says which one is meant.
    let progress = Progress::new(1);
    check_data(scene, settings, |step| {
        let what = match step.stage {
            CheckStage::Headers => "looking at pictures",
            CheckStage::Pictures => "decoding pictures",
            CheckStage::Pairs => "matching pairs of pictures",
            _ => "checking",
        };
        progress.say(format!("{}: {what}, {} of {}", scene.name, step.done, step.of));
    })
    .or_input()
}

/// The findings, the worst first.
fn show(report: &CheckReport) {
    print_line(&format!("{} ({}, {} frames)", report.name, report.format, report.frames));
    for Finding { severity, place, rule, text } in &report.findings {
        let severity = match severity {
            Severity::Ok => "ok",
            Severity::Note => "note",
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        print_line(&format!("  {severity:<7} {place}: {text} [{rule}]"));
    }
}

/// `check.html` of the scene `room0` is `check-room0.html`.
fn of_scene(path: &Path, scene: &str) -> PathBuf {
    let part = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let scene = scene.replace(['/', '\\'], "_");
    path.with_file_name(format!("{}-{scene}.{}", part(path.file_stem()), part(path.extension())))
}
