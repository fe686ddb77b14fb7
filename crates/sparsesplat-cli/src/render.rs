//! `render`: a scene to pictures.

use crate::arguments::{Common, positive, size};
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::Outputs;
use crate::progress::Progress;
use crate::summary::{memory_line, print_line, warn};
use crate::video::{self, PathName};
use clap::Args;
use evaluate::{Recipe, Rendered, peak_rss_bytes, render_ellipsoids, render_view};
use gs_scene::{Camera, Gaussians, Intrinsics};
use report_parts::{DepthScale, Picture, count};
use serde::Serialize;
use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Instant;
use view_data::Dataset;

/// Render a scene from given cameras: colour, opacity and depth
///
/// Writes NAME.png, NAME-alpha.png and NAME-depth.png for every camera (near is light, far is dark, one scale for all), and
/// with --ellipsoids NAME-ellipsoids.png. With --path it writes frame-00000.png and so on for a moving camera, and path.mp4 if ffmpeg is on the PATH.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sparsesplat render scene.ply --cameras data/fox -o out/fox\n  \
                        sparsesplat render scene.ply --cameras data/fox --positions 0,7,20 --size 960x540 -o out/fox\n  \
                        sparsesplat render scene.ply --cameras data/fox --path orbit --frames 90 -o out/fox")]
pub(crate) struct Arguments {
    /// Scene: PLY, compressed PLY, SPZ, .splat or glTF (.glb), recognised by its content
    scene: PathBuf,
    /// Data set whose cameras to render from, of any layout (its photographs are not read)
    #[arg(long, value_name = "INPUT")]
    cameras: PathBuf,
    /// Folder for the pictures
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Positions in the list of frames, from 0 [default: all]
    #[arg(long, value_name = "I,J,...", value_delimiter = ',')]
    positions: Vec<usize>,
    /// Size of the pictures [default: that of the photographs]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Also render the Gaussians as solid ellipsoids, which shows their place, size and orientation; with --path, instead of colour
    #[arg(long)]
    ellipsoids: bool,
    /// Move the camera and write a video (pictures alone if ffmpeg is not on the PATH)
    #[arg(long, value_enum)]
    path: Option<PathName>,
    /// Number of frames of --path, 30 a second
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 120, requires = "path")]
    frames: usize,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    recipe: Recipe<()>,
    gaussians: usize,
    /// Gaussians that cannot be drawn: their stored numbers are not finite, or overflow.
    rejected: usize,
    views: Vec<ViewRecord>,
    device: UsedDevice,
    peak_rss_bytes: Option<u64>,
}

#[derive(Serialize)]
struct ViewRecord {
    name: String,
    width: usize,
    height: usize,
    seconds: f64,
    files: Vec<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let gaussians = output::read_scene(&arguments.scene)?.gaussians;
    let dataset = view_data::open(&arguments.cameras, None).or_input()?;
    let cameras = cameras(arguments, &dataset)?;
    if let Some(offset) = dataset.offset {
        warn(&format!(
            "{}: lies far from the origin: ({}, {}, {}) was subtracted from all positions, as it is when scenes are made of these data",
            dataset.name, offset.x, offset.y, offset.z
        ));
    }
    if let Some(path) = arguments.path {
        return render_path(arguments, common, &gaussians, &dataset, &cameras, path);
    }
    let pictures = pictures(arguments, &cameras)?;
    let files = dataset.files();
    pictures
        .iter()
        .flatten()
        .fold(Outputs::of(common), |outputs, (_, path)| outputs.with("--output", Some(path)))
        .spare(files.iter().chain([&arguments.scene]).map(PathBuf::as_path))?;
    output::check_folder(&arguments.output)?;
    let mut rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let progress = Progress::new(cameras.len());
    let mut rendered: Vec<(Rendered, f64)> = Vec::with_capacity(cameras.len());
    for (name, camera) in &cameras {
        progress.say(name.as_str());
        let begin = Instant::now();
        let view = render_view(&mut rasterizer, &gaussians, camera).or_work()?;
        rendered.push((view, begin.elapsed().as_secs_f64()));
        progress.step();
    }
    let scale = DepthScale::of(rendered.iter().map(|(view, _)| view.depth.as_slice()));
    let mut views = Vec::with_capacity(cameras.len());
    for (((name, camera), (view, seconds)), pictures) in cameras.iter().zip(&rendered).zip(pictures) {
        let (width, height) = (camera.width(), camera.height());
        for (kind, path) in &pictures {
            let picture = match kind {
                Kind::Colour => Picture::of_image(&view.image),
                Kind::Alpha => Picture::of_mask(width, height, &view.alpha),
                Kind::Depth => Picture::of_depth(width, height, &view.depth, scale),
                Kind::Ellipsoids => {
                    let solid = render_ellipsoids(&mut rasterizer, &gaussians, camera).or_work()?;
                    Picture::of_image(&solid.image)
                }
            };
            picture.save(path).or_work()?;
        }
        let files = pictures.into_iter().map(|(_, path)| path).collect();
        views.push(ViewRecord { name: name.clone(), width, height, seconds: *seconds, files });
    }
    drop(progress);
    let rejected = rendered.iter().map(|(view, _)| view.rejected).max().unwrap_or(0);
    warn_of_rejected(arguments, rejected, gaussians.len());
    let peak = peak_rss_bytes();
    let total: f64 = rendered.iter().map(|(_, seconds)| seconds).sum();
    print_line(&format!("{} views of {} Gaussians", views.len(), count(gaussians.len() as f64)));
    print_line(&format!("seconds    {total:.2}, {:.4} a view", total / views.len() as f64));
    print_line(&memory_line(peak));
    print_line(&device.line());
    print_line(&format!("pictures   {}", arguments.output.display()));
    if let Some(path) = &common.json {
        let recipe = crate::recipe(0, ());
        let record =
            Record { recipe, gaussians: gaussians.len(), rejected, views, device, peak_rss_bytes: peak };
        output::write_json(path, &record)?;
    }
    Ok(())
}

/// Frames of a moving camera, and a video.
fn render_path(
    arguments: &Arguments,
    common: &Common,
    gaussians: &Gaussians,
    dataset: &Dataset,
    cameras: &[(String, Camera)],
    path: PathName,
) -> Outcome {
    let stops: Vec<Camera> = cameras.iter().map(|(_, camera)| *camera).collect();
    let cameras = path.cameras(&stops, gaussians, arguments.frames)?;
    let mut files: Vec<PathBuf> =
        (0..cameras.len()).map(|i| video::frame_file(&arguments.output, i)).collect();
    files.push(video::video_file(&arguments.output));
    let read = dataset.files();
    files
        .iter()
        .fold(Outputs::of(common), |outputs, file| outputs.with("--output", Some(file)))
        .spare(read.iter().chain([&arguments.scene]).map(PathBuf::as_path))?;
    output::check_folder(&arguments.output)?;
    let mut rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let begin = Instant::now();
    let ellipsoids = arguments.ellipsoids;
    let rejected = video::write_frames(&mut rasterizer, gaussians, &cameras, ellipsoids, &arguments.output)?;
    let seconds = begin.elapsed().as_secs_f64();
    warn_of_rejected(arguments, rejected, gaussians.len());
    let made = video::encode(&arguments.output, cameras.len())?;
    files.truncate(cameras.len());
    files.extend(made.clone());
    let peak = peak_rss_bytes();
    print_line(&format!("{} frames of {} Gaussians", cameras.len(), count(gaussians.len() as f64)));
    print_line(&format!("seconds    {seconds:.2}, {:.4} a frame", seconds / cameras.len() as f64));
    print_line(&memory_line(peak));
    print_line(&device.line());
    print_line(&format!("pictures   {}", arguments.output.display()));
    if let Some(made) = &made {
        print_line(&format!("video      {}, {} frames a second", made.display(), video::RATE));
    }
    if let Some(path) = &common.json {
        let (width, height) = (cameras[0].width(), cameras[0].height());
        let views = vec![ViewRecord { name: "path".into(), width, height, seconds, files }];
        let recipe = crate::recipe(0, ());
        let record =
            Record { recipe, gaussians: gaussians.len(), rejected, views, device, peak_rss_bytes: peak };
        output::write_json(path, &record)?;
    }
    Ok(())
}

fn warn_of_rejected(arguments: &Arguments, rejected: usize, gaussians: usize) {
    if rejected > 0 {
        warn(&format!(
            "{}: {rejected} of {gaussians} Gaussians cannot be drawn: their stored numbers are not finite, or overflow",
            arguments.scene.display(),
        ));
    }
}

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Colour,
    Alpha,
    Depth,
    Ellipsoids,
}

impl Kind {
    /// What it adds to the name of the frame.
    fn suffix(self) -> &'static str {
        match self {
            Self::Colour => "",
            Self::Alpha => "-alpha",
            Self::Depth => "-depth",
            Self::Ellipsoids => "-ellipsoids",
        }
    }
}

/// The pictures of every camera, each with its file.
fn pictures(arguments: &Arguments, cameras: &[(String, Camera)]) -> Outcome<Vec<Vec<(Kind, PathBuf)>>> {
    let kinds = [Kind::Colour, Kind::Alpha, Kind::Depth, Kind::Ellipsoids];
    let kinds = &kinds[..if arguments.ellipsoids { 4 } else { 3 }];
    let mut taken: HashMap<PathBuf, &str> = HashMap::new();
    let mut all = Vec::with_capacity(cameras.len());
    for (name, _) in cameras {
        let mut files = Vec::with_capacity(kinds.len());
        for &kind in kinds {
            let path = arguments.output.join(format!("{name}{}.png", kind.suffix()));
            // A frame that is asked for twice gives the same pictures twice.
            if let Some(other) = taken.insert(path.clone(), name).filter(|other| other != name) {
                let file = path.display();
                return Err(Failure::input(format!(
                    "{file}: frames {other:?} and {name:?} both have a picture of this name: render them into two folders by --positions"
                )));
            }
            files.push((kind, path));
        }
        all.push(files);
    }
    Ok(all)
}

/// Names and cameras to look from.
fn cameras(arguments: &Arguments, dataset: &Dataset) -> Outcome<Vec<(String, Camera)>> {
    let all: Vec<usize> = (0..dataset.frames.len()).collect();
    let positions = if arguments.positions.is_empty() { &all } else { &arguments.positions };
    let camera = |&position: &usize| {
        let frame = dataset.frame(position).or_input()?;
        let camera = frame.camera().or_input()?;
        let camera = match arguments.size {
            Some(size) => covering(&camera, size).or_input()?,
            None => camera,
        };
        Ok((frame.name.clone(), camera))
    };
    positions.iter().map(camera).collect()
}

/// The camera scaled until it covers a size, and cut to it around its centre, as photographs are.
fn covering(camera: &Camera, (width, height): (usize, usize)) -> gs_scene::Result<Camera> {
    let old = *camera.intrinsics();
    let scale = (width as f64 / old.width as f64).max(height as f64 / old.height as f64);
    let shift =
        |centre: f64, new: usize, old: usize| centre * scale + 0.5 * (new as f64 - old as f64 * scale);
    camera.with_intrinsics(Intrinsics {
        fx: old.fx * scale,
        fy: old.fy * scale,
        cx: shift(old.cx, width, old.width),
        cy: shift(old.cy, height, old.height),
        width,
        height,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec2, DVec3};

    #[test]
    fn another_size_keeps_the_middle_of_the_view() {
        let lens = Intrinsics { fx: 100.0, fy: 90.0, cx: 30.0, cy: 20.0, width: 60, height: 40 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let wide = covering(&camera, (240, 80)).unwrap();
        // Four times as large, 160 rows cut to 80.
        assert_eq!(wide.project(DVec3::Z), Some(DVec2::new(120.0, 40.0)));
        assert_eq!(wide.intrinsics().fy, 360.0);
    }
}
