//! Times the renderer on a synthetic scene of textured walls: `cargo run --release -p gs-raster --example bench_render`.
//! Arguments: width, height, repetitions, counts of Gaussians; default 480 320 9 10000 40000 100000 150000 750000.

use glam::{DMat3, DVec3};
use gs_raster::{RenderSettings, render};
use gs_scene::{Camera, Gaussians, Intrinsics};

/// Surface-like Gaussians: flat discs of the size of their spacing on a floor and on walls around the camera.
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

fn main() {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<usize>().expect("a number"));
    let mut next = |default| arguments.next().unwrap_or(default);
    let (width, height, repetitions) = (next(480), next(320), next(9));
    let focal = 0.9 * width as f64;
    let lens =
        Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f64, cy: 0.5 * height as f64, width, height };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("a valid camera");
    println!(
        "{width}x{height}, {} threads, milliseconds (stages of the median run of {repetitions})",
        rayon::current_num_threads()
    );
    println!(
        "{:>8} {:>8} {:>10} {:>8} {:>7} {:>8} {:>7} {:>7}",
        "n", "visible", "pairs", "fastest", "total", "project", "bin", "blend"
    );
    let mut counts: Vec<usize> = arguments.collect();
    if counts.is_empty() {
        counts = vec![10_000, 40_000, 100_000, 150_000, 750_000];
    }
    for n in counts {
        let scene = scene(n);
        let mut runs: Vec<_> = (0..repetitions)
            .map(|_| {
                let start = std::time::Instant::now();
                let view = render(&scene, &camera, &RenderSettings::default()).expect("valid settings");
                (start.elapsed().as_secs_f64(), view.stats)
            })
            .collect();
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let fastest = runs[0].0 * 1e3;
        let (total, stats) = runs[runs.len() / 2];
        let s = stats.seconds;
        let [total, project, bin, blend] = [total, s.project, s.bin, s.blend].map(|t| t * 1e3);
        println!(
            "{n:>8} {:>8} {:>10} {fastest:>8.2} {total:>7.2} {project:>8.2} {bin:>7.2} {blend:>7.2}",
            stats.visible, stats.intersections
        );
    }
}
