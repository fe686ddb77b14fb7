//! `bench backproject`: pixels with depth to points.

use super::cpu::{self, Job, OURS};
use super::measure::pools;
use super::random::Random;
use crate::arguments::{Common, gaussians as count_above_0, positive, size};
use crate::failure::{Failure, OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::print;
use backproject::{Settings, ViewPixels, anchors};
use clap::Args;
use glam::{DMat3, DVec3};
use gs_scene::{Camera, FeatureMap, Image, Intrinsics};
use serde::Serialize;

/// Pixels with depth to points: time per point, by what is asked for beyond its position
///
/// Of six views of a wavy wall with a block before it, 10 km from the origin, pixels are chosen at random. Each row asks for all that the row
/// above it asks for, and more; feature maps have a quarter of the picture's width, or all of it.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  sparsesplat bench backproject\n  \
                        sparsesplat bench backproject --anchors 40k --runs 21 --json backproject.json")]
pub(crate) struct Arguments {
    /// How many pixels of the six views become points
    #[arg(long, value_name = "N", value_parser = count_above_0, default_value = "150k")]
    anchors: usize,
    /// Size of the six views
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "448x256")]
    size: (usize, usize),
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 9)]
    runs: usize,
}

const VIEWS: usize = 6;
const CHANNELS: usize = 32;

/// What `--json` says of the arguments.
#[derive(Serialize)]
struct Sizes {
    anchors: usize,
    width: usize,
    height: usize,
    views: usize,
    channels: usize,
    runs: usize,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let &Arguments { anchors: n, size: (width, height), runs } = arguments;
    let all = VIEWS * width * height;
    if n > all {
        let views = format!("{VIEWS} views of {width}x{height}");
        return Err(Failure::input(format!("--anchors: {n} asked for, {views} have {all} pixels")));
    }
    let pools = pools()?;
    let scene = Scene::new(width, height, n)?;
    let [none, quarter, full] = [None, Some(scene.features(4)?), Some(scene.features(1)?)];
    let image = Image::filled(width, height, [0.5; 3]).or_work()?;
    let with_normals = Settings::default();
    let without = Settings { normals: None, ..with_normals };
    let cases = [
        ("positions, rays, footprints", None, &none, without),
        ("+ normals", None, &none, with_normals),
        ("+ colours", Some(&image), &none, with_normals),
        ("+ 32 features, quarter width", Some(&image), &quarter, with_normals),
        ("+ 32 features, full width", Some(&image), &full, with_normals),
    ];
    let mut jobs = Vec::new();
    for pool in &pools {
        for &(name, image, features, settings) in &cases {
            let views = scene.views(image, features.as_deref());
            let lift = move || anchors(&views, &settings).map(drop).or_work();
            jobs.push(Job::new(OURS, name, (n, None), pool, lift));
        }
    }
    let progress = Progress::new(runs * jobs.len());
    let rows = cpu::rows("backproject", &jobs, runs, &progress)?;
    drop(progress);
    print(&cpu::table(&rows, "points").to_text());
    let sizes = Sizes { anchors: n, width, height, views: VIEWS, channels: CHANNELS, runs };
    cpu::write(common, sizes, &rows, ())
}

/// What all cases share.
struct Scene {
    cameras: Vec<Camera>,
    depths: Vec<Vec<f32>>,
    pixels: Vec<Vec<u32>>,
}

impl Scene {
    fn new(width: usize, height: usize, n: usize) -> Outcome<Self> {
        let (w, h) = (width as f64, height as f64);
        let lens = Intrinsics { fx: 0.9 * w, fy: 0.92 * w, cx: 0.49 * w, cy: 0.51 * h, width, height };
        let camera = |view: usize| {
            let position = DVec3::new(view as f64, 0.0, 1e4);
            Camera::new(lens, DMat3::from_rotation_y(0.1 * view as f64), position).or_work()
        };
        let share = |view: usize| n * (view + 1) / VIEWS - n * view / VIEWS;
        Ok(Self {
            cameras: (0..VIEWS).map(camera).collect::<Outcome<_>>()?,
            depths: (0..VIEWS).map(|view| depth(view, width, height)).collect(),
            pixels: (0..VIEWS).map(|view| chosen(view, width * height, share(view))).collect(),
        })
    }

    /// Feature maps of a part of the picture's width and height.
    fn features(&self, part: usize) -> Outcome<Vec<FeatureMap>> {
        let map = |(view, camera): (usize, &Camera)| {
            let (width, height) = (camera.width().div_ceil(part), camera.height().div_ceil(part));
            let data = (0..CHANNELS * width * height).map(|i| (i * 31 + view) as f32).collect();
            FeatureMap::new(CHANNELS, width, height, data).or_work()
        };
        self.cameras.iter().enumerate().map(map).collect()
    }

    fn views<'a>(
        &'a self,
        image: Option<&'a Image>,
        features: Option<&'a [FeatureMap]>,
    ) -> Vec<ViewPixels<'a>> {
        let view = |i: usize| ViewPixels {
            camera: &self.cameras[i],
            depth: &self.depths[i],
            pixels: &self.pixels[i],
            image,
            features: features.map(|maps| &maps[i]),
        };
        (0..VIEWS).map(view).collect()
    }
}

/// A wavy wall with a nearer block before it.
fn depth(view: usize, width: usize, height: usize) -> Vec<f32> {
    let value = |i: usize| {
        let (x, y) = (i % width, i / width);
        let block = (width / 3..width * 2 / 3).contains(&x) && (height / 3..height * 4 / 5).contains(&y);
        let wave = (x as f32 * 0.05 + view as f32).sin() * (y as f32 * 0.07).cos();
        let distance = if block { 2.0 } else { 5.0 };
        distance + 0.1 * wave
    };
    (0..width * height).map(value).collect()
}

/// So many of a view's pixels, ascending, in no pattern.
fn chosen(view: usize, pixels: usize, n: usize) -> Vec<u32> {
    let mut random = Random(view as u64);
    let mut keyed: Vec<(u64, u32)> = (0..pixels as u32).map(|pixel| (random.next(), pixel)).collect();
    keyed.sort_unstable();
    let mut chosen: Vec<u32> = keyed[..n].iter().map(|&(_, pixel)| pixel).collect();
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chosen_pixel_becomes_a_point() {
        let scene = Scene::new(30, 20, 1001).unwrap();
        let features = scene.features(4).unwrap();
        let found = anchors(&scene.views(None, Some(&features)), &Settings::default()).unwrap();
        assert_eq!((found.anchors.len(), found.anchors.channels), (1001, CHANNELS));
    }
}
