//! `demo`: the main job on a simulated scene.

use crate::arguments::{Common, Pipeline, Range, size};
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::progress::{Progress, describe};
use crate::summary::{counts_line, memory_line, print, print_line, refinement_line, seconds_line, shortfall};
use crate::view;
use clap::Args;
use evaluate::{Recipe, Runner, WindowRow, means, peak_rss_bytes};
use report::{PictureLimits, Report, figures_table};
use report_parts::Picture;
use scene_windows::{SIMULATED_SIZE, SimulatedScene, simulated_window};
use serde::Serialize;
use splat_formats::Format;
use std::path::PathBuf;
use std::time::Instant;

/// Simulate a scene, reconstruct it and compare with held-out views; nothing to download
///
/// A courtyard is ray-traced. Six of the pictures are reconstructed; five more are held out and compared with renderings of
/// the reconstruction. Writes scene.ply (see --format), images/, report.html (open it in a browser), view.html (the scene, live) and result.json.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sparsesplat demo\n  sparsesplat demo --gaussians 150k -o out/demo150\n  sparsesplat demo --refine 60\n  \
                        sparsesplat demo --backbone given-depth      with the simulation's exact depth"
)]
pub(crate) struct Arguments {
    /// Output folder
    #[arg(short, long, value_name = "DIR", default_value = "out/demo")]
    output: PathBuf,
    /// Format of the scene: ply, compressed.ply, spz, splat or glb
    #[arg(long, value_name = "FORMAT", default_value = "ply", value_parser = output::parse_format)]
    format: Format,
    /// Size of the simulated photographs
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Seed of the sampling
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    #[command(flatten)]
    pipeline: Pipeline,
}

/// What result.json and `--json` hold.
#[derive(Serialize)]
struct Record<'a, C> {
    recipe: &'a Recipe<C>,
    #[serde(flatten)]
    row: &'a WindowRow,
    /// Ray tracing of the photographs; not part of `seconds`.
    simulation_seconds: f64,
    device: &'a UsedDevice,
    peak_rss_bytes: Option<u64>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    if arguments.pipeline.depth_range == Range::Hint {
        return Err(Failure::input(
            "the simulated scene has no hint: --depth-range takes estimate or NEAR,FAR here",
        ));
    }
    output::check_folder(&arguments.output)?;
    let method = arguments.pipeline.method(arguments.seed, &common.given)?;
    let runner = Runner::on(method.clone(), device::of_networks(common.device)).map_err(Failure::sorted)?;
    let mut rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let progress = Progress::new(1);
    progress.say("ray-tracing the photographs");
    let begin = Instant::now();
    let window =
        simulated_window(SimulatedScene::Courtyard, arguments.size.unwrap_or(SIMULATED_SIZE)).or_input()?;
    let simulation = begin.elapsed().as_secs_f64();
    let mut outcome = runner
        .measure(&window, None, &mut rasterizer, &mut |step| progress.say(describe(step)))
        .map_err(Failure::sorted)?;

    progress.say("writing");
    let begin = Instant::now();
    let scene = arguments.output.join(format!("scene.{}", arguments.format.extension()));
    let gaussians = &outcome.prediction.gaussians;
    output::write_scene(&scene, arguments.format, gaussians, |loss| progress.warn(loss))?;
    let seconds = &mut outcome.figures.figures.seconds;
    seconds.write = begin.elapsed().as_secs_f64();
    seconds.total += seconds.write;

    let images = arguments.output.join("images");
    for view in window.context.iter().chain(&window.targets) {
        Picture::of_image(view.image()).save(&images.join(format!("{}.png", view.name()))).or_work()?;
    }
    for (view, rendered) in window.targets.iter().zip(&outcome.renderings) {
        let name = view.name();
        Picture::of_image(&rendered.image).save(&images.join(format!("{name}-rendered.png"))).or_work()?;
        Picture::of_error(view.image(), &rendered.image)
            .save(&images.join(format!("{name}-error.png")))
            .or_work()?;
    }

    let peak = peak_rss_bytes();
    let recipe = crate::recipe(arguments.seed, &method);
    let row = WindowRow::new(&window, vec![outcome.figures.clone()]);
    let mut report = Report::new(
        "SparseSplat demo",
        "A simulated courtyard: six photographs in, a compact set of 3D Gaussians out, shown from views that the method \
         never saw.",
    );
    report.headline(&row.figures, peak);
    report.window(&window, &outcome, PictureLimits::ONE_WINDOW).or_work()?;
    let view_page = arguments.output.join("view.html");
    let (gaussians, renderings) = (&outcome.prediction.gaussians, &outcome.renderings);
    let (link, view_size) = view::write_for_window(&view_page, &window, gaussians, renderings)?;
    report.viewer(&window.name, &link, &view_size);
    let page = arguments.output.join("report.html");
    output::write_text(&page, &report.to_html(&output::to_json(&recipe)?))?;
    let record = Record {
        recipe: &recipe,
        row: &row,
        simulation_seconds: simulation,
        device: &device,
        peak_rss_bytes: peak,
    };
    output::write_json(&arguments.output.join("result.json"), &record)?;
    if let Some(path) = &common.json {
        output::write_json(path, &record)?;
    }
    if let Some(warning) = shortfall(&outcome.figures, &method) {
        progress.warn(&warning);
    }
    drop(progress);

    let rows = [row];
    let (scenes, mean) = means(&rows);
    print(&figures_table(&rows, &scenes, &mean, None, true).to_text());
    print_line(&format!(
        "simulation {simulation:.2} s for {} photographs",
        window.context.len() + window.targets.len()
    ));
    print_line(&counts_line(&outcome.figures));
    if let Some(line) = refinement_line(&outcome.figures) {
        print_line(&line);
    }
    print_line(&seconds_line(&outcome.figures));
    print_line(&memory_line(peak));
    print_line(&device.line());
    print_line(&format!("scene      {}", scene.display()));
    print_line(&format!("report     {}", page.display()));
    print_line(&format!("viewer     {}, {view_size}", view_page.display()));
    Ok(())
}
