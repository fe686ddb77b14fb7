//! `eval`: tables of figures on data sets.

use crate::arguments::{Common, LpipsWeights, Pipeline, Range, scenes, seeds};
use crate::datasets::Dataset;
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::{Outputs, named};
use crate::progress::{Progress, describe};
use crate::source::{Planned, Source, files_of};
use crate::summary::{print, print_line};
use crate::view;
use clap::Args;
use evaluate::{Evaluation, Event, Method, Recipe, Runner, evaluate, peak_rss_bytes};
use report::{PictureLimits, Report, figures_table, refinement_plot};
use scene_windows::{GeometryCache, Reading};
use serde::Serialize;
use std::path::PathBuf;

/// Measure held-out views: PSNR, SSIM, Gaussians and time, per scene and in the mean
///
/// Every window is reconstructed from its context views and measured on its held-out targets. Windows come from an index
/// file (pixelSplat's layout, keys scene/window); without one, from the path of a video, or from views chosen by their overlap.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat eval --dataset simulated\n  \
    sparsesplat eval --dataset nerfstudio --root data/fox --index data/fox/evaluation_index.json --json fox.json\n  \
    sparsesplat eval --dataset nerfstudio --root data --refine 200 --refine-plot refine.svg\n  \
    sparsesplat eval --dataset nerfstudio --root data --seeds 0,1,2 --report report.html\n  \
    sparsesplat eval --dataset simulated --lpips-weights vgg16-397923af.pth vgg.pth\n  \
    sparsesplat eval --dataset dl3dv --root benchmark --backbone depthsplat --head depthsplat --allocation pixel-aligned\n  \
    sparsesplat eval --dataset replica --root Replica --windows 5\n  \
    sparsesplat eval --dataset replica                                 print the expected layout and where to get the data\n  \
    sparsesplat eval --dataset dl3dv --root benchmark --index dl3dv_index.json\n\n\
    All scenes below --root are measured. A scene or window that is left out is listed with the reason.\n\
    A window that fails is listed as dropped, and the exit code is 1.")]
pub(crate) struct Arguments {
    /// Data set, or the layout of your own data
    #[arg(long, value_enum)]
    dataset: Dataset,
    #[command(flatten)]
    source: Source,
    /// With simulated: number of generated scenes (seeds 0, 1, ...) in addition to the scene of the demo
    #[arg(long, value_name = "N", value_parser = scenes(0), default_value_t = 0)]
    scenes: usize,
    /// Seeds of the sampling; with several the table shows mean and spread
    #[arg(long, value_delimiter = ',', default_value = "0", allow_negative_numbers = true)]
    seeds: Vec<u64>,
    /// Write a report with pictures
    #[arg(long, value_name = "PATH")]
    report: Option<PathBuf>,
    /// Measure held-out views during --refine and draw PSNR over seconds (SVG)
    #[arg(long, value_name = "PATH", hide_short_help = true)]
    refine_plot: Option<PathBuf>,
    /// Print the table as Markdown
    #[arg(long)]
    markdown: bool,
    /// Cache depth and features of each window in this folder, which `train` can share; features then have 11 bits
    #[arg(long, value_name = "DIR", hide_short_help = true)]
    cache: Option<PathBuf>,
    #[command(flatten)]
    lpips: LpipsWeights,
    #[command(flatten)]
    pipeline: Pipeline,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a, C> {
    recipe: &'a Recipe<C>,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    device: &'a UsedDevice,
    peak_rss_bytes: Option<u64>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let page = arguments.report.as_deref().and_then(view::page_beside);
    let outputs = Outputs::of(common)
        .with("--report", arguments.report.as_ref())
        .with("--report (the page of the scene)", page.as_ref())
        .with("--refine-plot", arguments.refine_plot.as_ref())
        .check()?;
    if arguments.refine_plot.is_some()
        && arguments.pipeline.refine.is_none()
        && arguments.pipeline.refine_seconds.is_none()
    {
        return Err(Failure::input("--refine-plot needs --refine STEPS or --refine-seconds S"));
    }
    let seeds = seeds(&arguments.seeds);
    let depth_hint = arguments.pipeline.depth_range == Range::Hint;
    let planned = arguments.source.plan(arguments.dataset, arguments.scenes, depth_hint, &common.given)?;
    let Planned { plans, dropped: unread, reading } = planned;
    outputs.spare(files_of(&plans).iter().map(PathBuf::as_path))?;
    outputs
        .spare(arguments.source.files().chain(arguments.pipeline.files()).chain(arguments.lpips.paths()))?;

    let cache = arguments.cache.clone().map(|folder| GeometryCache { folder });
    if let Some(cache) = &cache {
        output::check_folder(&cache.folder)?;
    }
    let method = Method {
        curve: arguments.refine_plot.is_some(),
        cache,
        ..arguments.pipeline.method(seeds[0], &common.given)?
    };
    let runner = Runner::on(method, device::of_networks(common.device)).map_err(Failure::sorted)?;
    let lpips = arguments.lpips.read()?;
    let mut rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let limits = PictureLimits::for_windows(plans.len());
    let mut report = Report::new("SparseSplat evaluation", evaluate::PROTOCOL);
    let mut problem = None;
    // The first window's scene, name of its file and size.
    let mut viewer: Option<(String, Outcome<(String, String)>)> = None;
    let progress = Progress::new(plans.len() * seeds.len());
    let mut told = "";
    for plan in &plans {
        // Once for all windows of a scene.
        let scene = scene_windows::scene_of(plan.name());
        if told != scene {
            progress.warn_of_data(scene, plan);
        }
        told = scene;
    }
    let mut running = String::new();
    let mut evaluation =
        evaluate(&plans, &runner, &seeds, lpips.as_ref(), &mut rasterizer, &mut |event| match event {
            Event::Run { name, seed } => running = format!("{name} (seed {seed})"),
            Event::Step(step) => progress.say(format!("{running}: {}", describe(step))),
            Event::Done { window, outcome } => {
                progress.step();
                if arguments.report.is_some() && outcome.figures.seed == seeds[0] {
                    problem = report.window(window, outcome, limits).err().or(problem.take());
                    if let (Some(page), None) = (&page, &viewer) {
                        let (gaussians, renderings) = (&outcome.prediction.gaussians, &outcome.renderings);
                        let written = view::write_for_window(page, window, gaussians, renderings);
                        viewer = Some((window.name.clone(), written));
                    }
                }
            }
            Event::Dropped(dropped) => {
                progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
            }
            _ => {}
        });
    for dropped in &unread {
        progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
    }
    evaluation.dropped.extend(unread);
    drop(progress);
    if let Some(problem) = problem {
        return Err(problem).or_work();
    }

    let table = figures_table(
        &evaluation.windows,
        &evaluation.scenes,
        &evaluation.mean,
        evaluation.lpips_network,
        true,
    );
    print(&if arguments.markdown { table.to_markdown() } else { table.to_text() });
    for window in evaluation.windows.iter().filter(|window| window.targets.is_empty()) {
        print_line(&format!(
            "{}: - stands where nothing is held out: fewer --views leave photographs to measure on, or an index names some",
            window.name
        ));
    }
    let scenes: Vec<&str> = evaluation.scenes.iter().map(|scene| scene.name.as_str()).collect();
    print_line(&format!("scenes     {}: {}", scenes.len(), scenes.join(", ")));
    print_line(&format!("data       sha256 {}", evaluation.data_sha256));
    if !arguments.markdown {
        print_line(&device.line());
    }
    let peak = peak_rss_bytes();
    let settings = Settings { seeds: &seeds, reading, method: runner.method() };
    let recipe = crate::recipe(seeds[0], settings);
    if let Some(path) = &common.json {
        let record =
            Record { recipe: &recipe, evaluation: &evaluation, device: &device, peak_rss_bytes: peak };
        output::write_json(path, &record)?;
    }
    if let Some(path) = &arguments.report {
        report.headline(&evaluation.mean.figures, peak);
        let viewer =
            viewer.map(|(name, written)| written.map(|(link, size)| (name, link, size))).transpose()?;
        if let (Some(page), Some((name, link, size))) = (&page, &viewer) {
            report.viewer(name, link, size);
            print_line(&format!("viewer     {}, {size}", named(page)));
        }
        if !evaluation.dropped.is_empty() {
            let names: Vec<&str> = evaluation.dropped.iter().map(|dropped| dropped.name.as_str()).collect();
            report.warning(&format!("Dropped, and not in the means: {}", names.join(", ")));
        }
        report
            .table(&table, "PSNR in dB and SSIM of held-out targets; gain over the nearest photograph in dB");
        output::write_text(path, &report.to_html(&output::to_json(&recipe)?))?;
        print_line(&format!("report     {}", named(path)));
    }
    if let Some(path) = &arguments.refine_plot {
        output::write_text(path, &refinement_plot(&evaluation.windows))?;
        print_line(&format!("plot       {}", named(path)));
    }
    match evaluation.dropped.iter().filter(|dropped| dropped.failed).count() {
        0 => Ok(()),
        n => Err(Failure::work(format!("{n} windows or scenes were dropped and are not in the means"))),
    }
}

/// The settings in the recipe.
#[derive(Serialize)]
struct Settings<'a> {
    seeds: &'a [u64],
    reading: Reading,
    /// With the depth hint, the range is the data set's.
    #[serde(flatten)]
    method: &'a Method,
}
