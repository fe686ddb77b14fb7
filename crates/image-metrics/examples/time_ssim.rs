//! Time of the loss with its gradient, of the target that it needs once, and of the f64 measure, on smooth shading under
//! noise: medians and minima of 101 calls.
//! `RAYON_NUM_THREADS=2 cargo run --release -p image-metrics --example time_ssim`

use image_metrics::{Result, SsimScratch, SsimTarget, ssim_rgb};
use std::hint::black_box;
use std::time::Instant;

const REPEATS: usize = 101;

fn main() -> Result<()> {
    for (width, height) in [(480, 320), (448, 256)] {
        let (a, b) = (picture(width, height, 1), picture(width, height, 2));
        println!("{width}x{height}");
        let target = SsimTarget::new(&b, width, height)?;
        let (mut gradient, mut scratch) = (vec![0.0; a.len()], SsimScratch::default());
        report("loss with gradient", || {
            target.loss_with_gradient(black_box(&a), 1.0, &mut gradient, &mut scratch)
        })?;
        report("new target", || SsimTarget::new(black_box(&b), width, height))?;
        report("ssim in f64", || ssim_rgb(black_box(&a), &b, width, height))?;
    }
    Ok(())
}

fn picture(width: usize, height: usize, seed: u64) -> Vec<f32> {
    let mut noise = seed;
    (0..width * height * 3)
        .map(|i| {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (x, y) = ((i / 3 % width) as f64, (i / 3 / width) as f64);
            let shading = 0.5 + 0.3 * (x / 40.0).sin() * (y / 30.0).cos();
            (shading + 0.1 * ((noise >> 40) as f64 / (1u64 << 24) as f64 - 0.5)) as f32
        })
        .collect()
}

fn report<R>(what: &str, mut run: impl FnMut() -> Result<R>) -> Result<()> {
    let mut times = Vec::new();
    for _ in 0..REPEATS {
        let start = Instant::now();
        black_box(run()?);
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    println!("  {what:20} median {:6.2} ms, least {:6.2} ms", times[REPEATS / 2], times[0]);
    Ok(())
}
