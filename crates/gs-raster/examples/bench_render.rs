//! Times the renderer on the CPU on a synthetic scene of textured walls, nearly all of it visible:
//! `cargo run --release -p gs-raster --example bench_render`. Arguments: width, height, repetitions, counts of Gaussians;
//! default 448 256 15 10000 40000 100000 150000 688000.
//!
//! The last two columns are the time from activated arrays beside that from stored Gaussians, in turns, the median of the ratios:
//! a picture; and a recorded picture with its gradients.

use glam::{DMat3, DVec3};
use gs_raster::{Activated, Colors, PixelGradients, Rasterizer, RenderSettings};
use gs_scene::{Camera, Gaussians, Intrinsics};
use std::time::Instant;

/// Surface-like Gaussians: flat discs of the size of their spacing on a floor and on walls before the camera.
fn scene(n: usize) -> Gaussians {
    let mut scene = Gaussians::empty(2).expect("degree 2 exists");
    let mut state = 1u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let spacing = (30.0 / n as f32).sqrt();
    for _ in 0..n {
        let (u, v, face) = (uniform() * 4.0 - 2.0, uniform() * 2.5 - 1.25, (uniform() * 3.0) as usize);
        let (mean, flat) = match face {
            0 => ([u, v, 4.0 + 0.1 * (3.0 * u).sin()], 2),
            1 => ([u, 1.25, v + 3.0], 1),
            _ => ([if u > 0.0 { 2.0 } else { -2.0 }, v, u.abs() + 2.0], 0),
        };
        let mut scale = [0, 1, 2].map(|_| (spacing * (0.4 + 0.6 * uniform())).ln());
        scale[flat] -= 2.0;
        let tilt = [0, 1, 2].map(|_| 0.2 * (uniform() - 0.5));
        let sh: Vec<f32> = (0..27).map(|k| (uniform() - 0.5) * if k < 3 { 2.0 } else { 0.2 }).collect();
        scene.push(mean, [1.0, tilt[0], tilt[1], tilt[2]], scale, 4.0 * uniform() - 0.5, &sh);
    }
    scene
}

/// Least and median, milliseconds.
fn times(mut seconds: Vec<f64>) -> [f64; 2] {
    seconds.sort_by(f64::total_cmp);
    [seconds[0], seconds[seconds.len() / 2]].map(|seconds| seconds * 1e3)
}

/// Seconds of a call.
fn seconds(call: impl FnOnce()) -> f64 {
    let start = Instant::now();
    call();
    start.elapsed().as_secs_f64()
}

/// Time from activated arrays beside that from stored Gaussians: of a picture, and of a recorded picture with its gradients.
fn ratios(scene: &Gaussians, camera: &Camera, pixels: &PixelGradients, repetitions: usize) -> [f64; 2] {
    let columns = |from: usize, to: usize| -> Vec<f32> {
        scene.geometry().chunks_exact(11).flat_map(|row| row[from..to].to_vec()).collect()
    };
    let (means, quats) = (columns(0, 3), columns(3, 7));
    let scales: Vec<f32> = columns(7, 10).into_iter().map(f32::exp).collect();
    let opacities: Vec<f32> = columns(10, 11).into_iter().map(gs_scene::sigmoid).collect();
    let kind = Colors::Sh { degree: 2, per_gaussian: 9 };
    let arrays = Activated {
        means: &means,
        quats: &quats,
        scales: &scales,
        opacities: &opacities,
        colors: scene.sh(),
        kind,
    };
    let (mut rasterizer, settings) = (Rasterizer::cpu(), RenderSettings::default());
    let mut found = [Vec::new(), Vec::new()];
    for _ in 0..repetitions {
        let stored = seconds(|| drop(rasterizer.render(scene, camera, &settings).expect("valid")));
        let activated =
            seconds(|| drop(rasterizer.render_activated(&arrays, &[*camera], &settings).expect("valid")));
        found[0].push(activated / stored);
        let views = std::slice::from_ref(pixels);
        let stored = seconds(|| {
            let (_, tape) = rasterizer.record(scene, &[*camera], &settings).expect("valid");
            drop(rasterizer.backward(scene, &tape, views).expect("valid"));
        });
        let activated = seconds(|| {
            let (_, tape) = rasterizer.record_activated(&arrays, &[*camera], &settings).expect("valid");
            drop(rasterizer.backward_activated(&arrays, &tape, views).expect("valid"));
        });
        found[1].push(activated / stored);
    }
    found.map(|ratios| times(ratios)[1] * 1e-3)
}

fn main() {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<usize>().expect("a number"));
    let mut next = |default| arguments.next().unwrap_or(default);
    let (width, height, repetitions) = (next(448), next(256), next(15));
    let focal = 0.9 * width as f64;
    let lens =
        Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f64, cy: 0.5 * height as f64, width, height };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(0.0, 0.0, 2.2)).expect("a valid camera");
    println!(
        "{width}x{height}, {} threads, milliseconds (least of {repetitions}, median; stages of the fastest run)",
        rayon::current_num_threads()
    );
    println!(
        "{:>8} {:>8} {:>8} {:>7} {:>7} {:>8} {:>7} {:>7} {:>9} {:>8} {:>8} {:>8} {:>7} {:>8}",
        "n",
        "visible",
        "pairs",
        "forward",
        "median",
        "project",
        "bin",
        "blend",
        "recorded",
        "median",
        "backward",
        "median",
        "arrays",
        "gradient"
    );
    let mut counts: Vec<usize> = arguments.collect();
    if counts.is_empty() {
        counts = vec![10_000, 40_000, 100_000, 150_000, 688_000];
    }
    let settings = RenderSettings::default();
    let pixels = PixelGradients {
        image: (0..width * height * 3).map(|i| ((i % 7) as f32 - 3.0) * 0.1).collect(),
        alpha: None,
        depth: None,
    };
    for n in counts {
        let scene = scene(n);
        let mut rasterizer = Rasterizer::cpu();
        let mut runs = Vec::with_capacity(repetitions);
        for _ in 0..repetitions {
            let start = Instant::now();
            let view = rasterizer.render(&scene, &camera, &settings).expect("valid settings");
            runs.push((start.elapsed().as_secs_f64(), view.stats));
        }
        let (mut recorded, mut backward) = (Vec::new(), Vec::new());
        for _ in 0..repetitions {
            let start = Instant::now();
            let (_, tape) = rasterizer.record(&scene, &[camera], &settings).expect("valid settings");
            recorded.push(start.elapsed().as_secs_f64());
            let start = Instant::now();
            let gradients = rasterizer.backward(&scene, &tape, std::slice::from_ref(&pixels));
            gradients.expect("fitting gradients");
            backward.push(start.elapsed().as_secs_f64());
        }
        let [forward, forward_median] = times(runs.iter().map(|run| run.0).collect());
        let [recorded, recorded_median] = times(recorded);
        let [backward, backward_median] = times(backward);
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let stats = runs[0].1;
        let [arrays, training] = ratios(&scene, &camera, &pixels, repetitions);
        let s = stats.seconds;
        let [project, bin, blend] = [s.project, s.bin, s.blend].map(|t| t * 1e3);
        println!(
            "{n:>8} {:>8} {:>8} {forward:>7.2} {forward_median:>7.2} {project:>8.2} {bin:>7.2} {blend:>7.2} \
             {recorded:>9.2} {recorded_median:>8.2} {backward:>8.2} {backward_median:>8.2} {arrays:>7.3} {training:>8.3}",
            stats.visible, stats.intersections
        );
    }
}
