//! `reconstruct`: posed photographs to a scene.

use crate::arguments::{Common, Pipeline, Range, positive, size};
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::{Outputs, named};
use crate::poses::{How, OnTheWay};
use crate::progress::{Progress, describe};
use crate::summary::{
    counts_line, held_out_line, memory_line, print_line, refinement_line, seconds_line, shortfall,
};
use crate::view;
use clap::Args;
use evaluate::{Recipe, Runner, Step, WindowFigures, peak_rss_bytes};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Lens, LensModel, View};
use report::{PictureLimits, Report};
use scene_windows::{Choice, Plan, Reading};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use view_data::{DatasetWriter, Format, Layout, PictureFormat};

/// Reconstruct a 3D Gaussian scene from photographs
///
/// INPUT is a data set with poses: nerfstudio, COLMAP, Replica, TUM RGB-D, ScanNet, DL3DV or RealEstate10K; or, with --poses, a folder
/// of photographs or a video without poses. From its frames a connected set of views is
/// chosen that covers as much of the scene as possible; --index and --window take the context views of an index file instead.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat reconstruct photos --poses -o scene.ply                 photographs without poses; so does video.mp4\n  \
    sparsesplat reconstruct data/fox -o fox.ply\n  \
    sparsesplat reconstruct data/fox -o fox.spz                         an eighth of the size, for viewers\n  \
    sparsesplat reconstruct data/fox --views 8 --gaussians 150k -o fox.ply --report fox.html\n  \
    sparsesplat reconstruct data/fox --index data/fox/evaluation_index.json --window fox/1 -o fox.ply\n  \
    sparsesplat reconstruct data/fox --refine 60 -o fox.ply             better by 0.5 dB on photographs, in some more seconds\n  \
    sparsesplat reconstruct data/kitchen --backbone given-depth --tau 0.3 -o kitchen.ply\n  \
    sparsesplat reconstruct data/fox --backbone depthsplat --weights depthsplat-gs-small-....pth --depth-range hint -o fox.ply")]
pub(crate) struct Arguments {
    /// Folder of a posed data set, or the file that describes it; with --poses, a folder of photographs or a video
    input: PathBuf,
    /// Estimate the poses first, and keep them beside the scene (scene-poses/ for scene.ply)
    #[arg(long, conflicts_with_all = ["format", "index"])]
    poses: bool,
    /// Layout of the data set: nerfstudio, colmap, replica, tum, scannet, chunk, dl3dv or re10k [default: recognised by its files]
    #[arg(long, value_name = "LAYOUT")]
    format: Option<Format>,
    /// Scene to write: .ply (keeps every bit), .compressed.ply, .spz, .splat or .glb; `convert --help` says what each keeps
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Number of photographs to use
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 6, conflicts_with = "index")]
    views: usize,
    /// Index file with windows (pixelSplat's layout), to take context views from
    #[arg(long, value_name = "FILE", requires = "window", hide_short_help = true)]
    index: Option<PathBuf>,
    /// Key of the window in the index file, scene/window
    #[arg(long, value_name = "KEY", requires = "index", hide_short_help = true)]
    window: Option<String>,
    /// Scale and crop photographs to this size [default: their size on disk]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Seed of the sampling
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Measure held-out views (frames between the chosen ones, or the window's targets) and write a report with pictures; a page
    /// that shows the scene in the browser goes beside it (fox.html has fox-view.html)
    #[arg(long, value_name = "PATH")]
    report: Option<PathBuf>,
    /// Folder for a data set (nerfstudio) of the photographs used, with the cameras that --refine-poses found, in the scene's coordinates
    #[arg(
        long,
        value_name = "DIR",
        requires = "refine_poses",
        help_heading = "Refinement",
        hide_short_help = true
    )]
    refined_poses: Option<PathBuf>,
    #[command(flatten)]
    how: How,
    #[command(flatten)]
    pipeline: Pipeline,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a, C> {
    recipe: &'a Recipe<C>,
    name: &'a str,
    views: usize,
    choice: Option<&'a Choice>,
    /// Estimation of the poses, where that was asked for; its seconds are part of the total.
    poses: Option<&'a OnTheWay>,
    /// What was subtracted from the positions of the data; the scene lacks it.
    offset: Option<[f64; 3]>,
    #[serde(flatten)]
    figures: &'a WindowFigures,
    /// None if nothing was rendered.
    device: Option<&'a UsedDevice>,
    peak_rss_bytes: Option<u64>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let page = arguments.report.as_deref().and_then(view::page_beside);
    let outputs = Outputs::of(common)
        .with("--output", Some(&arguments.output))
        .with("--report", arguments.report.as_ref())
        .with("--report (the page of the scene)", page.as_ref())
        .check()?;
    let depth_hint = arguments.pipeline.depth_range == Range::Hint;
    let reading = Reading { format: arguments.format, size: arguments.size, depth_hint };
    let progress = Progress::new(1);
    let poses = if arguments.poses {
        let (scene, input) = (&arguments.output, &arguments.input);
        Some(OnTheWay::beside(scene, input, &arguments.how, common, &progress)?)
    } else {
        common.given.refuse(&How::NAMES, "it is for --poses, which estimates poses first")?;
        None
    };
    let input = poses.as_ref().map_or(&arguments.input, |poses| &poses.folder);
    let mut plan = match (&arguments.index, &arguments.window) {
        (Some(index), Some(key)) => Plan::window(input, index, key, reading),
        _ => Plan::selection(input, arguments.views, reading),
    }
    .or_input()?;
    outputs.spare(plan.files().iter().map(PathBuf::as_path))?;
    outputs.spare(arguments.index.as_deref().into_iter().chain(arguments.pipeline.files()))?;
    let format = output::scene_format(&arguments.output)?;
    let mut method = arguments.pipeline.method(arguments.seed, &common.given)?;
    method.predict.depth_range = plan.depth_range(method.predict.depth_range);
    let refined_poses = arguments.refined_poses.as_deref().map(data_set).transpose()?;
    let begin = Instant::now();
    let runner = Runner::on(method.clone(), device::of_networks(common.device)).map_err(Failure::sorted)?;
    let reading = begin.elapsed().as_secs_f64();

    // Nobody waits for a GPU that has nothing to do.
    let renders = arguments.report.is_some() || method.refine.is_some();
    let mut rasterizer = if renders { device::rasterizer(common.device)? } else { Rasterizer::cpu() };
    let device = renders.then(|| UsedDevice::of(&rasterizer));
    progress.warn_of_data(plan.name(), &plan);
    progress.say(describe(Step::Load));
    let known = plan.ledger().len();
    let window = plan.load_what_is_whole(arguments.report.is_some()).or_input()?;
    progress.warn_of_ledger(plan.name(), &plan.ledger()[known..]);
    let mut on_step = |step| progress.say(describe(step));
    let mut outcome = match arguments.report {
        Some(_) => runner.measure(&window, None, &mut rasterizer, &mut on_step),
        None => runner.reconstruct(&window, &mut rasterizer, &mut on_step),
    }
    .map_err(Failure::sorted)?;
    progress.say("writing");
    let begin = Instant::now();
    let gaussians = &outcome.prediction.gaussians;
    output::write_scene(&arguments.output, format, gaussians, |loss| progress.warn(loss))?;
    if let (Some(writer), Some(found)) = (refined_poses, &outcome.figures.refinement) {
        write_views(writer, &window.context, &found.cameras)?;
    }
    let seconds = &mut outcome.figures.figures.seconds;
    seconds.write = begin.elapsed().as_secs_f64();
    seconds.load += reading;
    seconds.poses = poses.as_ref().map_or(0.0, |poses| poses.seconds);
    seconds.total += seconds.poses + reading + seconds.write;

    let peak = peak_rss_bytes();
    let recipe = crate::recipe(arguments.seed, &method);
    let mut viewer = None;
    if let Some(path) = &arguments.report {
        let mut report = Report::new("SparseSplat reconstruction", "Posed photographs in, 3D Gaussians out.");
        report.headline(&outcome.figures.figures, peak);
        report.window(&window, &outcome, PictureLimits::ONE_WINDOW).or_work()?;
        if let Some(page) = &page {
            let (gaussians, renderings) = (&outcome.prediction.gaussians, &outcome.renderings);
            let (link, size) = view::write_for_window(page, &window, gaussians, renderings)?;
            report.viewer(&window.name, &link, &size);
            viewer = Some(size);
        }
        output::write_text(path, &report.to_html(&output::to_json(&recipe)?))?;
    }
    if let Some(path) = &common.json {
        let record = Record {
            recipe: &recipe,
            name: &window.name,
            views: window.context.len(),
            choice: plan.choice(),
            poses: poses.as_ref(),
            offset: plan.offset(),
            figures: &outcome.figures,
            device: device.as_ref(),
            peak_rss_bytes: peak,
        };
        output::write_json(path, &record)?;
    }
    if let Some(warning) = shortfall(&outcome.figures, &method) {
        progress.warn(&warning);
    }
    drop(progress);

    for line in poses.iter().flat_map(OnTheWay::lines) {
        print_line(&line);
    }
    let names: Vec<&str> = window.context.iter().map(|view| view.name()).collect();
    print_line(&format!("views      {}: {}", names.len(), names.join(", ")));
    if let Some(uncovered) = plan.choice().and_then(|choice| choice.uncovered) {
        print_line(&format!("coverage   {:.0} % of the frames are left uncovered", 100.0 * uncovered));
    }
    print_line(&counts_line(&outcome.figures));
    for line in [refinement_line(&outcome.figures), held_out_line(&outcome.figures)].into_iter().flatten() {
        print_line(&line);
    }
    if arguments.report.is_some() && window.targets.is_empty() {
        print_line(
            "held out   nothing is measured: no photographs lie between the chosen ones; fewer --views leave some",
        );
    }
    print_line(&seconds_line(&outcome.figures));
    print_line(&memory_line(peak));
    if let Some(device) = &device {
        print_line(&device.line());
    }
    print_line(&format!("scene      {}", named(&arguments.output)));
    if let Some(path) = &arguments.report {
        print_line(&format!("report     {}", named(path)));
    }
    if let (Some(page), Some(size)) = (&page, viewer) {
        print_line(&format!("viewer     {}, {size}", named(page)));
    }
    if let Some(folder) = &arguments.refined_poses {
        print_line(&format!("data set   {}", folder.display()));
    }
    Ok(())
}

/// A folder that is refused before long work if it holds something.
fn data_set(folder: &Path) -> Outcome<DatasetWriter> {
    DatasetWriter::create(folder, Layout::Nerfstudio, PictureFormat::Png).or_input()
}

/// Writes photographs without distortion, with cameras that differ from theirs.
fn write_views(mut writer: DatasetWriter, views: &[View], cameras: &[Camera]) -> Outcome {
    for (view, camera) in views.iter().zip(cameras) {
        let moved = View::new(view.name(), view.image().clone(), *camera, view.depth().cloned()).or_work()?;
        let lens = Lens { intrinsics: *camera.intrinsics(), model: LensModel::PINHOLE };
        writer.add(&moved, &lens).or_work()?;
    }
    writer.finish().or_work()?;
    Ok(())
}
