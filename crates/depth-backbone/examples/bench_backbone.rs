//! Time of DepthSplat's network by stage, with weights by rule:
//!
//! `cargo run --release -p depth-backbone --features depthsplat --example bench_backbone -- s1_u8l8 vits 448x256 2 6`
//!
//! Layout, ViT, size of the views, numbers of views. Operations are counted by the definition of convolutions and matrix
//! products, so that a fast algorithm may exceed the machine's rate, which is measured beside it: candle's product of
//! two square matrices, of 1024 rows, on as many threads.

use candle_core::{Device, Tensor};
use depth_backbone::{DepthSplat, Scales, StageTime, Variant, Vit};
use glam::DVec3;
use gs_scene::{Camera, Image, Intrinsics, View};
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

/// Passes that are timed; the median counts.
const RUNS: usize = 3;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument =
        |i: usize, default: &'static str| arguments.get(i).map_or(default, String::as_str).to_owned();
    let scales = argument(0, "s1_u8l8");
    let vit = argument(1, "vits");
    let variant = Variant {
        scales: Scales::ALL
            .into_iter()
            .find(|s| s.name() == scales)
            .ok_or("the first argument is a layout")?,
        vit: Vit::ALL.into_iter().find(|v| v.name() == vit).ok_or("the second argument is a ViT")?,
    };
    let size = argument(2, "448x256");
    let (width, height) = size.split_once('x').ok_or("the third argument is a size, such as 448x256")?;
    let (width, height) = (width.parse()?, height.parse()?);
    let mut counts: Vec<usize> = arguments.iter().skip(3).map(|n| n.parse()).collect::<Result<_, _>>()?;
    if counts.is_empty() {
        counts = vec![2, 6];
    }
    let start = Instant::now();
    let network = DepthSplat::untrained(variant, "")?;
    let loading = start.elapsed().as_secs_f64();
    println!("{variant}, {width}x{height}; weights made and packed in {loading:.2} s; {}", memory());
    for count in counts {
        let views = (0..count).map(|i| view(i, width, height)).collect::<Result<Vec<_>, Failure>>()?;
        bench(&network, &views)?;
    }
    Ok(())
}

/// A picture of waves, and cameras on a line.
fn view(i: usize, width: usize, height: usize) -> Result<View, Failure> {
    let (w, h) = (width as f64, height as f64);
    let lens = Intrinsics { fx: 0.9 * w, fy: 0.9 * w, cx: w / 2.0, cy: h / 2.0, width, height };
    let position = DVec3::new(0.3 * i as f64, 0.02 * i as f64, 0.0);
    let camera = Camera::looking_at(lens, position, DVec3::new(0.5, 0.0, 5.0), DVec3::new(0.0, -1.0, 0.0))?;
    let value = |k: usize| {
        let (x, y, c) = ((k / 3 % width) as f64, (k / 3 / width) as f64, (k % 3) as f64);
        let wave = (0.11 * x + 0.7 * i as f64 + c).sin() + (0.07 * y + 0.003 * x * c).cos();
        (0.5 + 0.24 * wave) as f32
    };
    let image = Image::new(width, height, (0..width * height * 3).map(value).collect())?;
    Ok(View::new(i.to_string(), image, camera, None)?)
}

fn bench(network: &DepthSplat, views: &[View]) -> Result<(), Failure> {
    let ranges = vec![(0.5, 200.0); views.len()];
    let mut runs = Vec::new();
    for _ in 0..RUNS {
        let rate = gemm_rate()?;
        let start = Instant::now();
        let (_, trace) = network.trace(views, &ranges, false)?;
        runs.push((start.elapsed().as_secs_f64(), trace.stages, rate));
    }
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let fastest = runs[0].0;
    let (seconds, stages, rate) = &runs[RUNS / 2];
    println!(
        "\n{} views: {seconds:.2} s, median of {RUNS} (fastest {fastest:.2} s); {}",
        views.len(),
        memory()
    );
    println!("the machine multiplies matrices at {rate:.1} GFLOP/s");
    println!("{:20} {:>8} {:>8} {:>8} {:>7}", "stage", "seconds", "GFLOP", "GFLOP/s", "share");
    let mut sum = StageTime { stage: "sum", seconds: 0.0, operations: 0 };
    for stage in stages {
        row(stage, *rate);
        sum.seconds += stage.seconds;
        sum.operations += stage.operations;
    }
    row(&sum, *rate);
    let depth_alone = sum.seconds
        - stages.iter().filter(|s| s.stage == "feature upsampler").map(|s| s.seconds).sum::<f64>();
    println!("without the feature upsampler {depth_alone:.2} s");
    Ok(())
}

fn row(stage: &StageTime, rate: f64) {
    let giga = stage.operations as f64 * 1e-9;
    let speed = giga / stage.seconds;
    let share = 100.0 * speed / rate;
    println!("{:20} {:8.3} {giga:8.1} {speed:8.1} {share:6.0}%", stage.stage, stage.seconds);
}

/// GFLOP/s of candle's matrix product.
fn gemm_rate() -> Result<f64, Failure> {
    const N: usize = 1024;
    let matrix =
        |k: usize| Tensor::from_vec((0..N * N).map(|i| (i % k) as f32).collect(), (N, N), &Device::Cpu);
    let (a, b) = (matrix(7)?, matrix(11)?);
    let mut best = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        a.matmul(&b)?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(2.0 * (N * N * N) as f64 / best * 1e-9)
}

/// Largest memory of the process so far, where the system tells.
fn memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes: Option<f64> = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse().ok());
    kilobytes.map_or("peak memory unknown".to_owned(), |k| format!("peak memory {:.0} MB", k * 1.024e-3))
}
