//! Time of each step on six 448×256 views of smooth shading under noise.
//! `RAYON_NUM_THREADS=2 cargo run --release -p entropy-sampler --example time_views`

use entropy_sampler::{
    Border, Budget, EntropyWindow, ImportanceMap, Result, Sampler, entropy, sample, solve,
};
use std::time::Instant;

const WIDTH: usize = 448;
const HEIGHT: usize = 256;
const VIEWS: usize = 6;
const REPEATS: usize = 20;

fn main() -> Result<()> {
    let views: Vec<Vec<u8>> = (0..VIEWS).map(picture).collect();
    let window = EntropyWindow::default();
    for size in [3, 5, 7, 9, 15] {
        for border in [Border::Reflect, Border::Clip] {
            let window = EntropyWindow { size, border, ..window };
            report(&format!("entropy {size}x{size}, {border:?}"), || {
                for view in &views {
                    std::hint::black_box(entropy(view, WIDTH, HEIGHT, window)?);
                }
                Ok(())
            })?;
        }
    }
    let maps: Vec<ImportanceMap> = views
        .iter()
        .map(|view| ImportanceMap::entropy(view, WIDTH, HEIGHT, window))
        .collect::<Result<_>>()?;
    report("tau for 40k", || {
        std::hint::black_box(solve(&maps, 40_000.0)?);
        Ok(())
    })?;
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        report(&format!("sample 40k, {sampler:?}"), || {
            std::hint::black_box(sample(&maps, Budget::Count(40_000), sampler, 0)?);
            Ok(())
        })?;
    }
    Ok(())
}

fn picture(view: usize) -> Vec<u8> {
    let mut noise = view as u64 + 1;
    (0..WIDTH * HEIGHT)
        .map(|i| {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            let shading = 128.0 + 60.0 * (x / 40.0).sin() * (y / 30.0 + view as f64).cos();
            let amplitude = if (x as usize / 64 + y as usize / 64).is_multiple_of(2) { 4.0 } else { 30.0 };
            (shading + amplitude * ((noise >> 40) as f64 / (1u64 << 24) as f64 - 0.5)) as u8
        })
        .collect()
}

/// Prints the best of several runs.
fn report(what: &str, mut run: impl FnMut() -> Result<()>) -> Result<()> {
    let mut best = f64::INFINITY;
    for _ in 0..REPEATS {
        let start = Instant::now();
        run()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    let per_pixel = best * 1e9 / (VIEWS * WIDTH * HEIGHT) as f64;
    println!("{what:24} {:6.2} ms, {per_pixel:5.1} ns per pixel", best * 1e3);
    Ok(())
}
