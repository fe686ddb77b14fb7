//! `poses`: photographs or a video to a posed data set.

use crate::arguments::Common;
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::Outputs;
use crate::progress::Progress;
use crate::summary::{memory_line, print_line};
use clap::{Args, ValueEnum};
use evaluate::{Recipe, peak_rss_bytes};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use view_poses::{Cut, EngineChoice, Estimate, Settings, Step, Up, estimate_poses, is_made_from, is_video};

/// Estimate the camera poses of photographs or of a video
///
/// INPUT is a folder of PNG or JPEG photographs, or a video (which needs the program ffmpeg). The output is a data set that every other command
/// takes as INPUT: images/, transforms.json, and sparse/0/ in COLMAP's layout. poses.json says how it was made and what speaks against it.
/// EXIF focal length and orientation are used. Blurred photographs and copies are left out and reported.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  \
    sparsesplat poses PHOTOS -o scene\n  \
    sparsesplat poses video.mp4 --frames 60 --from 2 --to 20 -o scene\n  \
    sparsesplat reconstruct scene -o scene.ply")]
pub(crate) struct Arguments {
    /// Folder of photographs, or a video
    input: PathBuf,
    /// Folder of the data set to write; it must not exist, or be empty
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    how: How,
}

/// How poses are estimated.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Poses")]
pub(crate) struct How {
    /// Engine that estimates poses
    #[arg(long, value_enum, default_value = "auto")]
    engine: EngineName,
    /// Number of frames to take from a video: the sharpest of each stretch
    #[arg(long, value_name = "N", value_parser = frames, default_value_t = Cut::default().frames)]
    frames: usize,
    /// Seconds of the video at which to begin
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    from: Option<f64>,
    /// Seconds of the video at which to end
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    to: Option<f64>,
    /// Keep blurred photographs and copies
    #[arg(long)]
    keep_all: bool,
    /// Write pinhole photographs, without the distortion of the lens
    #[arg(long)]
    undistort: bool,
}

/// Engine that estimates poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EngineName {
    /// openmvg; if its result is doubtful, colmap too where it is installed; the better result
    Auto,
    /// openMVG-rs, built in
    Openmvg,
    /// The program COLMAP
    Colmap,
    /// The program COLMAP from version 4 on, with its global mapper
    ColmapGlobal,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: Recipe<Settings>,
    #[serde(flatten)]
    estimate: &'a Estimate,
    seconds: f64,
    peak_rss_bytes: Option<u64>,
}

impl How {
    /// The options, by their long names.
    pub(crate) const NAMES: [&'static str; 6] = ["engine", "frames", "from", "to", "keep-all", "undistort"];

    fn settings(&self, input: &Path, common: &Common) -> Outcome<Settings> {
        if !is_video(input) {
            common.given.refuse(&["frames", "from", "to"], "it is for a video, and INPUT is none")?;
        }
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from >= to
        {
            return Err(Failure::input(format!(
                "--from {from} --to {to}: expected an end after the beginning"
            )));
        }
        Ok(Settings {
            engine: match self.engine {
                EngineName::Auto => EngineChoice::Auto,
                EngineName::Openmvg => EngineChoice::OpenMvg,
                EngineName::Colmap => EngineChoice::Colmap,
                EngineName::ColmapGlobal => EngineChoice::ColmapGlobal,
            },
            cut: Cut { frames: self.frames, from: self.from, to: self.to },
            keep_all: self.keep_all,
            undistort: self.undistort,
            seed: 0,
        })
    }
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    Outputs::of(common).check()?;
    let settings = arguments.how.settings(&arguments.input, common)?;
    let progress = Progress::new(1);
    let begin = Instant::now();
    let estimate = estimated(&arguments.input, &arguments.output, &settings, &progress)?;
    let seconds = begin.elapsed().as_secs_f64();
    drop(progress);
    if let Some(path) = &common.json {
        let recipe = crate::recipe(settings.seed, settings);
        output::write_json(
            path,
            &Record { recipe, estimate: &estimate, seconds, peak_rss_bytes: peak_rss_bytes() },
        )?;
    }
    print_line(&poses_line(&estimate, seconds));
    for line in details(&estimate) {
        print_line(&line);
    }
    print_line(&memory_line(peak_rss_bytes()));
    print_line(&format!("data set   {}", arguments.output.display()));
    Ok(())
}

/// Poses on the way to a scene.
#[derive(Serialize)]
pub(crate) struct OnTheWay {
    /// The data set, beside the scene.
    pub(crate) folder: PathBuf,
    /// None if the folder was there, made from the same input.
    pub(crate) estimate: Option<Estimate>,
    pub(crate) seconds: f64,
}

impl OnTheWay {
    /// Estimates poses and writes the data set beside the scene, as `scene-poses` for `scene.ply`. One that was made from the same input with
    /// the same settings is taken as it is.
    pub(crate) fn beside(
        scene: &Path,
        input: &Path,
        how: &How,
        common: &Common,
        progress: &Progress,
    ) -> Outcome<Self> {
        let settings = how.settings(input, common)?;
        let mut name = scene.file_stem().unwrap_or_default().to_owned();
        if name == "-" || name.is_empty() {
            return Err(Failure::input(
                "--poses keeps the poses beside the scene: -o needs the name of a file",
            ));
        }
        name.push("-poses");
        let folder = scene.with_file_name(name);
        let begin = Instant::now();
        let estimate = if is_made_from(&folder, input, &settings) {
            None
        } else {
            Some(estimated(input, &folder, &settings, progress)?)
        };
        Ok(Self { folder, estimate, seconds: begin.elapsed().as_secs_f64() })
    }

    /// What to print.
    pub(crate) fn lines(&self) -> Vec<String> {
        let folder = self.folder.display();
        match &self.estimate {
            Some(estimate) => vec![poses_line(estimate, self.seconds), format!("data set   {folder}")],
            None => vec![format!(
                "poses      those of {folder}, made from the same input before; remove it to estimate them again"
            )],
        }
    }
}

fn estimated(input: &Path, folder: &Path, settings: &Settings, progress: &Progress) -> Outcome<Estimate> {
    progress.say("reading photographs");
    let say = |step| progress.say(describe(step));
    let estimate = estimate_poses(input, folder, settings, &say).or_input()?;
    for doubt in &estimate.verdict.doubts {
        progress.warn(&format!("the poses are doubtful: {doubt}"));
    }
    if let Some(advice) = &estimate.advice {
        let flag = if advice.contains("the engine ") { " (--engine)" } else { "" };
        progress.warn(&format!("what helps: {advice}{flag}"));
    }
    if estimate.other_formats > 0 {
        progress.warn(&format!(
            "not used: pictures in other formats (HEIC, TIFF, WebP, raw ...): {}; convert them to JPEG or PNG",
            estimate.other_formats
        ));
    }
    const SHOWN: usize = 5;
    for left_out in estimate.not_used.iter().take(SHOWN) {
        progress.warn(&format!("not used: {}: {}", left_out.photograph, left_out.reason));
    }
    if let Some(more) = estimate.not_used.len().checked_sub(SHOWN).filter(|more| *more > 0) {
        let record = folder.join(view_poses::RECORD);
        progress.warn(&format!("not used: {more} more; {} lists them", record.display()));
    }
    Ok(estimate)
}

fn describe(step: Step) -> String {
    match step {
        Step::Frames(count) => format!("looking at frames: {count}"),
        Step::Read(done, total) => format!("reading photographs, {done} of {total}"),
        Step::Features => "finding features".to_owned(),
        Step::Match => "matching photographs".to_owned(),
        Step::Poses => "finding poses".to_owned(),
        Step::Again(engine) => format!("the result is doubtful: {engine} tries again"),
        Step::Undistort => "taking the distortion of the lens out".to_owned(),
        Step::Check => "checking the poses".to_owned(),
        _ => "working".to_owned(),
    }
}

fn poses_line(estimate: &Estimate, seconds: f64) -> String {
    let verdict = &estimate.verdict;
    let doubts = if verdict.doubts.is_empty() { "" } else { "; doubtful, see the warnings" };
    format!(
        "poses      {seconds:.2} s: {} of {} photographs, engine {}{doubts}",
        verdict.registered, verdict.photographs, estimate.engine
    )
}

fn details(estimate: &Estimate) -> Vec<String> {
    let verdict = &estimate.verdict;
    let focal: Vec<String> =
        verdict.focal_lengths.iter().flatten().map(|focal| format!("{focal:.3}")).collect();
    let pixels = |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{value:.2} px"));
    let mut lines = vec![
        format!("focal      {} long sides of the picture", focal.join(", ")),
        format!(
            "errors     {} reprojection (median), {} epipolar (90 %), at 480 px",
            pixels(verdict.reprojection),
            pixels(verdict.epipolar)
        ),
    ];
    if estimate.turned > 0 {
        lines.push(format!("turned     {} photographs as EXIF says", estimate.turned));
    }
    let up = match estimate.levelling.up {
        Up::Horizon => "up is +z",
        Up::Cameras => "up is +z, by the mean of the photographs' up alone: it may be tilted",
        Up::Unknown => "up is not known",
    };
    lines.push(format!("world      {up}; the unit is the median distance of the points from the cameras"));
    lines
}

fn frames(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|count| (2..=view_poses::MOST).contains(count));
    count.ok_or_else(|| format!("expected a number of frames, 2 to {}", view_poses::MOST))
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value: &f64| (0.0..1e6).contains(value))
        .ok_or_else(|| "expected seconds, 0 or more".to_owned())
}
