//! `simulate`: photographs of a described or generated scene, as a data set.

use crate::arguments::{Common, positive, size};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::output::Outputs;
use crate::progress::Progress;
use crate::summary::{memory_line, print_line};
use clap::{Args, ValueEnum};
use evaluate::{Recipe, peak_rss_bytes};
use gs_scene::Camera;
use report_parts::count;
use scene_sim::{
    Kind, Photographs, RayCounts, Scene, Traced, generate, generate_dwelling, generate_in_the_wild,
};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use view_data::{DatasetWriter, DepthPercentiles, Layout, PictureFormat};

/// Write a data set of a generated or described scene, with poses and exact depth
///
/// SCENE is a description (RON), or a scene of the original Replica release (a folder with mesh.ply). Without SCENE a scene is
/// generated from --seed. Only effects in the description are simulated: shadows, reflections, blur, noise and distortion.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat simulate --seed 7 -o desk                             a generated scene\n  \
    sparsesplat simulate --seed 0 --scenes 20 --kind room -o rooms    twenty scenes, one folder each\n  \
    sparsesplat simulate --seed 1 --kind garden --in-the-wild -o air  with varying exposure, noise and wrong poses\n  \
    sparsesplat simulate courtyard.ron --format colmap -o courtyard   a described scene\n  \
    sparsesplat simulate --seed 7 --write-scene desk.ron -o desk      also write its description, to edit\n  \
    sparsesplat simulate replica_v1/room_0 --photographs walk.ron --format replica -o Replica\n\n\
    nerfstudio: transforms.json, images/, depth/ (32-bit EXR). colmap: images/, sparse/0 with points. replica: as NICE-SLAM lays\n\
    it out, DIR/cam_params.json and a folder per scene in DIR, JPEG pictures, 16-bit depth up to 10 m.\n\
    Windows of context and held-out views along the path go to evaluation_index.json.")]
pub(crate) struct Arguments {
    /// Description of the scene (RON), or a folder of the original Replica release
    #[arg(required_unless_present = "seed")]
    scene: Option<PathBuf>,
    /// Seed of the pictures and, without SCENE, of the generated scene [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Kind of the generated scene [default: any]
    #[arg(long, value_enum, requires = "seed", conflicts_with = "scene")]
    kind: Option<KindName>,
    /// Photograph the scene the way strangers do: varying exposure, noise, slightly wrong poses, gardens from the air
    #[arg(long, requires = "seed", conflicts_with = "scene")]
    in_the_wild: bool,
    /// Number of scenes to generate, from consecutive seeds; each gets its own folder
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 1, conflicts_with = "scene")]
    scenes: usize,
    /// Layout of the data set
    #[arg(long, value_enum, default_value = "nerfstudio")]
    format: FormatName,
    /// Output folder; must be new or empty (for replica: must not hold a scene of that name)
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Camera settings (RON), instead of those in the description
    #[arg(long, value_name = "FILE", requires = "scene", hide_short_help = true)]
    photographs: Option<PathBuf>,
    /// Size of the pictures [default: that of the description]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Number of pictures along the path [default: that of the description]
    #[arg(long, value_name = "N", value_parser = positive)]
    frames: Option<usize>,
    /// Colour samples per pixel, best a square number [default: that of the description]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096), hide_short_help = true)]
    samples: Option<u32>,
    /// File format of the pictures; replica always uses JPEG
    #[arg(long, value_enum, default_value = "png")]
    pictures: PictureName,
    /// Write the description of the scene (RON) to this file
    #[arg(long, value_name = "FILE", conflicts_with = "scenes", hide_short_help = true)]
    write_scene: Option<PathBuf>,
}

/// Kinds of generated scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum KindName {
    /// Furnished rooms
    Room,
    /// Things on a desk
    Desk,
    /// Shelves full of things
    Shelves,
    /// Houses along a street
    Facade,
    /// Gardens with plants
    Garden,
    /// Trees and glades from the air
    Wood,
    /// Four rooms, with a path through all of them that goes round twice
    Dwelling,
}

/// Layouts that are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FormatName {
    /// transforms.json
    Nerfstudio,
    /// sparse/0/*.bin
    Colmap,
    /// sparse/0/*.txt
    ColmapText,
    /// traj.txt and results/
    Replica,
}

/// File formats of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PictureName {
    /// Lossless
    Png,
    /// JPEG of quality 95
    Jpeg,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<C> {
    recipe: Recipe<C>,
    scenes: Vec<SceneRecord>,
    peak_rss_bytes: Option<u64>,
}

/// One scene of it.
#[derive(Serialize)]
struct SceneRecord {
    name: String,
    folder: PathBuf,
    frames: usize,
    /// Windows in the evaluation index.
    windows: usize,
    rays: RayCounts,
    /// Pixels whose depth the layout cannot hold.
    depth_out_of_range: u64,
    /// What of the description is not seen, and why.
    dropped: Vec<String>,
    seconds: SceneSeconds,
}

/// Where the time went.
#[derive(Serialize)]
struct SceneSeconds {
    build: f64,
    render: f64,
    total: f64,
}

/// A scene to photograph.
struct Job {
    name: String,
    scene: Scene,
    /// Files that the description names are relative to it.
    folder: PathBuf,
    photographs: Photographs,
    target: PathBuf,
    seed: u64,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    output::check_folder(arguments.output.parent().unwrap_or(Path::new("")))?;
    let outputs = Outputs::of(common).with("--write-scene", arguments.write_scene.as_ref()).check()?;
    outputs.spare([&arguments.scene, &arguments.photographs].into_iter().flatten().map(PathBuf::as_path))?;
    if arguments.format == FormatName::Replica && arguments.pictures != PictureName::Jpeg {
        common.given.refuse(&["pictures"], "pictures of the layout replica are JPEG files")?;
    }
    if arguments.kind == Some(KindName::Dwelling) {
        common.given.refuse(&["in-the-wild"], "a dwelling is photographed in one way")?;
    }
    let jobs = jobs(arguments)?;
    if let (Some(path), [job]) = (&arguments.write_scene, jobs.as_slice()) {
        let described = Scene { photographs: Some(job.photographs.clone()), ..job.scene.clone() };
        output::write_text(path, &described.to_ron())?;
    }
    let progress = Progress::new(jobs.iter().map(|job| job.photographs.count).sum());
    let mut records = Vec::with_capacity(jobs.len());
    for job in &jobs {
        records.push(simulate(job, arguments, &progress)?);
    }
    drop(progress);
    for record in &records {
        let (rays, seconds) = (record.rays.rays() as f64, &record.seconds);
        print_line(&format!(
            "{}: {} frames, {} windows, {} rays in {:.1} s ({} a second)",
            record.name,
            record.frames,
            record.windows,
            count(rays),
            seconds.render,
            count(rays / seconds.render)
        ));
        for dropped in &record.dropped {
            print_line(&format!("  not seen: {dropped}"));
        }
        if record.depth_out_of_range > 0 {
            let lost = count(record.depth_out_of_range as f64);
            print_line(&format!(
                "  depth of {lost} pixels is beyond what the layout holds, and is not written"
            ));
        }
    }
    print_line(&memory_line(peak_rss_bytes()));
    print_line(&format!("data       {}", arguments.output.display()));
    if let Some(path) = &common.json {
        let settings = jobs.iter().map(|job| (job.seed, job.photographs.clone())).collect::<Vec<_>>();
        let recipe = crate::recipe(jobs[0].seed, settings);
        output::write_json(path, &Record { recipe, scenes: records, peak_rss_bytes: peak_rss_bytes() })?;
    }
    Ok(())
}

/// What is asked for, read and generated.
fn jobs(arguments: &Arguments) -> Outcome<Vec<Job>> {
    let mut jobs = Vec::new();
    match &arguments.scene {
        Some(path) => {
            let is_scan = path.is_dir();
            let scene = if is_scan { scene_sim::replica_scene(path) } else { scene_sim::read_scene(path) };
            let scene = scene.or_input()?;
            let folder = if is_scan { path.clone() } else { path.parent().unwrap_or(Path::new("")).into() };
            let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
            let name = name.ok_or_else(|| Failure::input(format!("{}: has no name", path.display())))?;
            jobs.push(job(arguments, name, scene, folder, arguments.seed.unwrap_or_default())?);
        }
        None => {
            let first = arguments.seed.unwrap_or_default();
            for seed in first..first.saturating_add(arguments.scenes as u64) {
                if arguments.kind == Some(KindName::Dwelling) {
                    let (name, scene) = (format!("dwelling-{seed}"), generate_dwelling(seed));
                    jobs.push(job(arguments, name, scene, PathBuf::new(), seed)?);
                    continue;
                }
                let (of_seed, generate, wild) = if arguments.in_the_wild {
                    (
                        Kind::of_seed_in_the_wild as fn(u64) -> Kind,
                        generate_in_the_wild as fn(Kind, u64) -> Scene,
                        "wild-",
                    )
                } else {
                    (Kind::of_seed as _, generate as _, "")
                };
                let kind = arguments.kind.and_then(KindName::kind).unwrap_or_else(|| of_seed(seed));
                let scene = generate(kind, seed);
                let name = format!("{wild}{}-{seed}", kind.name());
                jobs.push(job(arguments, name, scene, PathBuf::new(), seed)?);
            }
        }
    }
    Ok(jobs)
}

fn job(arguments: &Arguments, name: String, scene: Scene, folder: PathBuf, seed: u64) -> Outcome<Job> {
    let stated = match &arguments.photographs {
        Some(path) => Some(scene_sim::read_photographs(path).or_input()?),
        None => scene.photographs.clone(),
    };
    let Some(mut photographs) = stated else {
        return Err(Failure::input(format!(
            "{name}: the description does not say how it is photographed; add `photographs` to it, or give --photographs FILE"
        )));
    };
    if let Some((width, height)) = arguments.size {
        (photographs.width, photographs.height) = (width, height);
    }
    photographs.count = arguments.frames.unwrap_or(photographs.count);
    photographs.samples = arguments.samples.unwrap_or(photographs.samples);
    let has_own_folder = arguments.scenes > 1 || arguments.format == FormatName::Replica;
    let target = if has_own_folder { arguments.output.join(&name) } else { arguments.output.clone() };
    Ok(Job { name, scene, folder, photographs, target, seed })
}

fn simulate(job: &Job, arguments: &Arguments, progress: &Progress) -> Outcome<SceneRecord> {
    let begin = Instant::now();
    progress.say(format!("{}: sorting the scene", job.name));
    let traced = Traced::load(&job.scene, &job.folder).or_input()?;
    let build = begin.elapsed().as_secs_f64();
    let mut writer =
        DatasetWriter::create(&job.target, arguments.format.layout(), arguments.pictures.format())
            .or_input()?;
    let (mut rays, mut render) = (RayCounts::default(), 0.0);
    let (mut cameras, mut depths): (Vec<Camera>, Vec<f32>) = (Vec::new(), Vec::new());
    for index in 0..job.photographs.count {
        progress.say(format!("{}: frame {index}", job.name));
        let begin = Instant::now();
        let photograph = scene_sim::photograph(&traced, &job.photographs, index, job.seed).or_input()?;
        render += begin.elapsed().as_secs_f64();
        rays = rays + photograph.rays;
        cameras.push(*photograph.view.camera());
        if let Some(depth) = photograph.view.depth() {
            depths.extend(depth.data().iter().copied().filter(|z| *z > 0.0).step_by(DEPTH_STEP));
        }
        writer.add(&photograph.view, &photograph.lens).or_work()?;
        progress.step();
    }
    let written = writer.finish().or_work()?;
    let folder_name =
        job.target.file_name().map_or_else(|| job.name.clone(), |name| name.to_string_lossy().into());
    let windows = match DepthPercentiles::of(&mut depths) {
        Some(percentiles) => {
            let count = cameras.len().div_ceil(FRAMES_PER_WINDOW);
            let along = |context| {
                view_data::windows_along(&folder_name, &cameras, context, count, percentiles.into())
            };
            // A short path has room for fewer context views.
            let mut windows = Vec::new();
            for context in (2..=CONTEXT).rev() {
                windows = along(context).or_work()?.0;
                if !windows.is_empty() {
                    break;
                }
            }
            windows
        }
        None => Vec::new(),
    };
    if !windows.is_empty() {
        view_data::write_index(&written.folder.join("evaluation_index.json"), &windows).or_work()?;
    }
    Ok(SceneRecord {
        name: job.name.clone(),
        folder: written.folder,
        frames: written.frames,
        windows: windows.len(),
        rays,
        depth_out_of_range: written.depth_out_of_range,
        dropped: traced.dropped().iter().map(ToString::to_string).collect(),
        seconds: SceneSeconds { build, render, total: begin.elapsed().as_secs_f64() },
    })
}

/// Of the depths every so many is enough to know the scene's range.
const DEPTH_STEP: usize = 101;
/// Windows of the index begin every so many frames.
const FRAMES_PER_WINDOW: usize = 40;
/// Context views of a window, where the path has room for them.
const CONTEXT: usize = 6;

impl KindName {
    /// None of a dwelling, which has a generator of its own.
    fn kind(self) -> Option<Kind> {
        match self {
            Self::Room => Some(Kind::Room),
            Self::Desk => Some(Kind::Desk),
            Self::Shelves => Some(Kind::Shelves),
            Self::Facade => Some(Kind::Facade),
            Self::Garden => Some(Kind::Garden),
            Self::Wood => Some(Kind::Wood),
            Self::Dwelling => None,
        }
    }
}

impl FormatName {
    fn layout(self) -> Layout {
        match self {
            Self::Nerfstudio => Layout::Nerfstudio,
            Self::Colmap => Layout::Colmap,
            Self::ColmapText => Layout::ColmapText,
            Self::Replica => Layout::Replica,
        }
    }
}

impl PictureName {
    fn format(self) -> PictureFormat {
        match self {
            Self::Png => PictureFormat::Png,
            Self::Jpeg => PictureFormat::Jpeg,
        }
    }
}
