//! `view`: a scene as a page that draws it in the browser.

use crate::arguments::Common;
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output::{self, Outputs, named};
use crate::progress::Progress;
use crate::summary::{print_line, warn};
use clap::Args;
use evaluate::{Recipe, Rendered, render_view};
use gs_raster::RenderSettings;
use gs_scene::{Camera, Gaussians, Image};
use report_parts::{Picture, count};
use scene_windows::Window;
use serde::Serialize;
use std::path::{Path, PathBuf};
use view_data::Dataset;
use viewer::{Near, Page, Precision, Server, Shot, Still};

/// Long side of photographs in a page, and of the pictures for browsers without WebGPU, pixels.
const SIDE: u32 = 400;
/// Quality of their JPEGs.
const QUALITY: u8 = 75;
/// Pictures for browsers without WebGPU.
const STILLS: usize = 3;

/// Write a page that shows a scene in the browser, on WebGPU
///
/// The page is one file that needs no network. It starts at the camera of --cameras that sees most of the scene. Browsers without WebGPU show pictures that are rendered here.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  sparsesplat view scene.ply                              writes scene.html\n  \
                        sparsesplat view scene.ply --cameras data/fox -o fox.html\n  \
                        sparsesplat view scene.ply --cameras data/fox --serve"
)]
pub(crate) struct Arguments {
    /// Scene: PLY, compressed PLY, SPZ, .splat or glTF (.glb), recognised by its content
    scene: PathBuf,
    /// Page to write [default: beside the scene, with the extension html]
    #[arg(short, long, value_name = "HTML")]
    output: Option<PathBuf>,
    /// Data set whose cameras to look from, and whose photographs to compare with
    #[arg(long, value_name = "INPUT")]
    cameras: Option<PathBuf>,
    /// Number of photographs in the page, evenly spaced
    #[arg(long, value_name = "N", default_value_t = 12, requires = "cameras")]
    photographs: usize,
    /// Keep every bit of the scene; the page grows up to three times
    #[arg(long)]
    exact: bool,
    /// Serve the page on 127.0.0.1 instead of writing it, until Ctrl-C
    #[arg(long, conflicts_with = "output")]
    serve: bool,
    /// Port of --serve; 0 takes any free port
    #[arg(long, default_value_t = 8000, requires = "serve")]
    port: u16,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    recipe: Recipe<()>,
    gaussians: usize,
    cameras: usize,
    photographs: usize,
    bytes: usize,
    /// What rendered the pictures for browsers without WebGPU.
    device: UsedDevice,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    if arguments.serve {
        common.given.refuse(&["json"], "--serve writes no file")?;
    }
    let gaussians = output::read_scene(&arguments.scene)?.gaussians;
    let dataset =
        arguments.cameras.as_deref().map(|input| view_data::open(input, None)).transpose().or_input()?;
    let default = arguments.scene.with_extension("html");
    let path = arguments.output.as_ref().unwrap_or(&default);
    let outputs = Outputs::of(common).with("--output", (!arguments.serve).then_some(path)).check()?;
    let files = dataset.as_ref().map(Dataset::files).unwrap_or_default();
    outputs.spare(files.iter().chain([&arguments.scene]).map(PathBuf::as_path))?;
    let server = arguments.serve.then(|| Server::bind(arguments.port)).transpose().or_input()?;

    let progress = Progress::new(1);
    let shots = match &dataset {
        Some(dataset) => {
            progress.say("reading photographs");
            shots(dataset, arguments.photographs)?
        }
        None => vec![Shot {
            name: "overview".into(),
            camera: viewer::overview(&gaussians).or_work()?,
            photograph: None,
        }],
    };
    progress.say("rendering pictures for browsers without WebGPU");
    let mut rasterizer = device::rasterizer(common.device)?;
    let mut stills = Vec::new();
    for i in evenly(shots.len(), STILLS) {
        let Shot { name, camera, .. } = &shots[i];
        let lens = camera.intrinsics();
        let (width, height) = within(lens.width, lens.height);
        let camera = camera.with_intrinsics(lens.resized(width, height)).or_work()?;
        let view = render_view(&mut rasterizer, &gaussians, &camera).or_work()?;
        stills.push(Still { name: name.clone(), picture: jpeg(&view.image)? });
    }
    drop(progress);
    let title = arguments.scene.file_stem().map_or_else(|| "scene".into(), |stem| stem.to_string_lossy());
    let precision = if arguments.exact { Precision::Full } else { Precision::Compact };
    let cameras: Vec<Camera> = shots.iter().map(|shot| shot.camera).collect();
    let start = viewer::fullest(&cameras, &gaussians);
    let page = Page { start, ..page(&title, &gaussians, &shots, &stills, precision) };
    print_line(&format!("Gaussians  {}", count(gaussians.len() as f64)));
    let photographs = shots.iter().filter(|shot| shot.photograph.is_some()).count();
    print_line(&format!("cameras    {}, {photographs} with their photographs", shots.len()));
    if let Some(server) = server {
        let (html, scene) = page.html_beside("scene.bin").or_work()?;
        print_line(&format!(
            "page       {} on {}; Ctrl-C ends it",
            size(html.len() + scene.len()),
            server.address()
        ));
        return server.run(&html, &scene).or_work();
    }
    let html = page.html().or_work()?;
    output::write_text(path, &html)?;
    print_line(&format!("page       {}, {}", named(path), size(html.len())));
    if let Some(path) = &common.json {
        let recipe = crate::recipe(0, ());
        let (cameras, bytes, device) = (shots.len(), html.len(), UsedDevice::of(&rasterizer));
        output::write_json(
            path,
            &Record { recipe, gaussians: gaussians.len(), cameras, photographs, bytes, device },
        )?;
    }
    Ok(())
}

/// Writes a page of a reconstruction, with its views as cameras; returns the name of its file and its size.
pub(crate) fn write_for_window(
    path: &Path,
    window: &Window,
    gaussians: &Gaussians,
    renderings: &[Rendered],
) -> Outcome<(String, String)> {
    let mut shots = Vec::new();
    for view in window.context.iter().chain(&window.targets) {
        let photograph = Some(jpeg(view.image())?);
        shots.push(Shot { name: view.name().to_owned(), camera: *view.camera(), photograph });
    }
    let mut stills = Vec::new();
    for i in evenly(renderings.len(), STILLS) {
        let name = window.targets[i].name().to_owned();
        stills.push(Still { name, picture: jpeg(&renderings[i].image)? });
    }
    let html = page(&window.name, gaussians, &shots, &stills, Precision::Compact).html().or_work()?;
    output::write_text(path, &html)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((name, size(html.len())))
}

/// The page beside a report: `fox.html` has `fox-view.html`. None where the report goes to standard output or a device.
pub(crate) fn page_beside(report: &Path) -> Option<PathBuf> {
    let stem = report.file_stem()?.to_string_lossy().into_owned();
    let is_file = output::is_file(report);
    is_file.then(|| report.with_file_name(format!("{stem}-view.html")))
}

fn page<'a>(
    title: &'a str,
    gaussians: &'a Gaussians,
    shots: &'a [Shot],
    stills: &'a [Still],
    precision: Precision,
) -> Page<'a> {
    Page {
        title,
        gaussians,
        shots,
        start: 0,
        stills,
        settings: RenderSettings::default(),
        near: Near::OfScene,
        precision,
    }
}

/// Every camera of a data set, some of them with their photographs.
fn shots(dataset: &Dataset, photographs: usize) -> Outcome<Vec<Shot>> {
    if let Some(offset) = dataset.offset {
        warn(&format!(
            "{}: lies far from the origin: ({}, {}, {}) was subtracted from all positions, as it is when scenes are made of these data",
            dataset.name, offset.x, offset.y, offset.z
        ));
    }
    let present = dataset.present();
    if present.is_empty() {
        return Err(Failure::input(format!("{}: no frame has a picture", dataset.file.display())));
    }
    let with: Vec<usize> = evenly(present.len(), photographs).map(|i| present[i]).collect();
    let mut shots = Vec::with_capacity(present.len());
    for position in present {
        let frame = dataset.frame(position).or_input()?;
        let (camera, photograph): (Camera, _) = if with.contains(&position) {
            let view = dataset.load_views(&[position], None).or_input()?.swap_remove(0);
            (*view.camera(), Some(jpeg(view.image())?))
        } else {
            (frame.camera().or_input()?, None)
        };
        shots.push(Shot { name: frame.name.clone(), camera, photograph });
    }
    Ok(shots)
}

/// `n` of `all` places, evenly spaced from the first to the last; all where there are fewer.
fn evenly(all: usize, n: usize) -> impl Iterator<Item = usize> {
    let n = n.min(all);
    (0..n).map(move |i| if n > 1 { i * (all - 1) / (n - 1) } else { 0 })
}

/// A size whose sides are at most [`SIDE`].
fn within(width: usize, height: usize) -> (usize, usize) {
    let (most, long) = (SIDE as usize, width.max(height));
    if long <= most {
        (width, height)
    } else {
        ((width * most).div_ceil(long), (height * most).div_ceil(long))
    }
}

fn jpeg(image: &Image) -> Outcome<Vec<u8>> {
    let (width, _) = within(image.width(), image.height());
    Picture::of_image(image).at_most(width as u32).to_jpeg(QUALITY).or_work()
}

fn size(bytes: usize) -> String {
    format!("{:.2} MB", bytes as f64 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_are_spread_over_all() {
        let places = |all, n| evenly(all, n).collect::<Vec<_>>();
        assert_eq!(places(9, 3), [0, 4, 8]);
        assert_eq!(places(2, 12), [0, 1]);
        assert_eq!(places(5, 1), [0]);
        assert!(places(5, 0).is_empty() && places(0, 3).is_empty());
        assert_eq!(within(960, 540), (400, 225));
        assert_eq!(within(540, 960), (225, 400));
        assert_eq!(within(100, 7), (100, 7));
        assert_eq!(page_beside(Path::new("a/fox.html")).as_deref(), Some(Path::new("a/fox-view.html")));
        assert_eq!(page_beside(Path::new("-")), None);
    }
}
