//! Time of 150k anchors out of six 448×256 views, by what is asked for: median and least of interleaved runs.
//! `RAYON_NUM_THREADS=2 cargo run --release -p backproject --example time_anchors`

use backproject::{Settings, ViewPixels, anchors};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, FeatureMap, Image, Intrinsics};
use std::time::Instant;

const WIDTH: usize = 448;
const HEIGHT: usize = 256;
const VIEWS: usize = 6;
const ANCHORS: usize = 150_000;
const CHANNELS: usize = 32;
const RUNS: usize = 21;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let lens = Intrinsics { fx: 400.0, fy: 410.0, cx: 220.0, cy: 130.0, width: WIDTH, height: HEIGHT };
    let cameras: Vec<Camera> = (0..VIEWS)
        .map(|view| {
            Camera::new(lens, DMat3::from_rotation_y(0.1 * view as f64), DVec3::new(view as f64, 0.0, 1e4))
        })
        .collect::<Result<_, _>>()?;
    let depths: Vec<Vec<f32>> = (0..VIEWS).map(depth).collect();
    let pixels: Vec<Vec<u32>> = (0..VIEWS).map(chosen).collect();
    let image = Image::filled(WIDTH, HEIGHT, [0.5; 3])?;
    let features = |size: usize| -> gs_scene::Result<Vec<FeatureMap>> {
        let (width, height) = (WIDTH / size, HEIGHT / size);
        let map = |view: usize| {
            let data = (0..CHANNELS * width * height).map(|i| (i * 31 + view) as f32).collect();
            FeatureMap::new(CHANNELS, width, height, data)
        };
        (0..VIEWS).map(map).collect()
    };
    let (full, quarter) = (features(1)?, features(4)?);

    let views = |coloured: bool, features: Option<&'static str>| -> Vec<ViewPixels<'_>> {
        let view = |i: usize| ViewPixels {
            camera: &cameras[i],
            depth: &depths[i],
            pixels: &pixels[i],
            image: coloured.then_some(&image),
            features: features.map(|size| if size == "full" { &full[i] } else { &quarter[i] }),
        };
        (0..VIEWS).map(view).collect()
    };
    let with_normals = Settings::default();
    let without = Settings { normals: None, ..with_normals };
    let cases = [
        ("positions, rays, footprints", views(false, None), without),
        ("and normals", views(false, None), with_normals),
        ("and colours", views(true, None), with_normals),
        ("and 32 features, map of a quarter", views(true, Some("quarter")), with_normals),
        ("and 32 features, map of full size", views(true, Some("full")), with_normals),
    ];
    let mut seconds = vec![Vec::new(); cases.len()];
    for _ in 0..RUNS {
        for ((_, views, settings), seconds) in cases.iter().zip(&mut seconds) {
            let start = Instant::now();
            let found = anchors(views, settings)?;
            seconds.push(start.elapsed().as_secs_f64());
            assert_eq!(found.anchors.len(), ANCHORS);
        }
    }
    for ((what, ..), mut seconds) in cases.iter().zip(seconds) {
        seconds.sort_by(f64::total_cmp);
        println!("{what:34} median {:6.2} ms, least {:6.2} ms", seconds[RUNS / 2] * 1e3, seconds[0] * 1e3);
    }
    Ok(())
}

/// A wavy wall with a nearer block before it.
fn depth(view: usize) -> Vec<f32> {
    let at = |i: usize| {
        let (x, y) = ((i % WIDTH) as f32, (i / WIDTH) as f32);
        let block = (150.0..300.0).contains(&x) && (80.0..200.0).contains(&y);
        (if block { 2.0 } else { 5.0 }) + 0.1 * (x * 0.05 + view as f32).sin() * (y * 0.07).cos()
    };
    (0..WIDTH * HEIGHT).map(at).collect()
}

/// The view's share of the pixels, ascending, in no pattern.
fn chosen(view: usize) -> Vec<u32> {
    let mut random = view as u64 + 1;
    let mut keyed: Vec<(u64, u32)> = (0..(WIDTH * HEIGHT) as u32)
        .map(|pixel| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 20, pixel)
        })
        .collect();
    keyed.sort_unstable();
    let mut pixels: Vec<u32> = keyed[..ANCHORS / VIEWS].iter().map(|&(_, pixel)| pixel).collect();
    pixels.sort_unstable();
    pixels
}
