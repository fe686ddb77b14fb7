//! What each file format of a scene costs: size, time, and quality on held-out views of the demo's scene.
//!
//! `cargo run --release -p evaluate --example measure_formats [GAUSSIANS [SCENE...]]` prints the table of docs/bench/formats.md, and
//! the quality of other files of the same scene.

use evaluate::{Method, Runner, render_view};
use gs_raster::Rasterizer;
use gs_scene::Gaussians;
use scene_windows::{SIMULATED_SIZE, SimulatedScene, Window, simulated_window};
use sparsesplat::{Budget, Config};
use splat_formats::{Format, read_scene, write_scene};
use std::error::Error;
use std::time::Instant;

/// Each time is the least of so many.
const REPEATS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let count = std::env::args().nth(1).map_or(Ok(40_000), |count| count.parse())?;
    let window = simulated_window(SimulatedScene::Courtyard, SIMULATED_SIZE)?;
    let config = Config { budget: Budget::Gaussians(count), ..Config::default() };
    let mut rasterizer = Rasterizer::cpu();
    let runner = Runner::new(Method::feed_forward(config))?;
    let outcome = runner.measure(&window, None, &mut rasterizer, &mut |_| {})?;
    let scene = outcome.prediction.gaussians;
    let reference = psnr(&scene, &window, &mut rasterizer)?;
    println!(
        "{} Gaussians of SH degree {}, {} held-out views, PSNR {reference:.3} dB\n",
        scene.len(),
        scene.sh_degree(),
        window.targets.len()
    );
    println!("| format | bytes | bytes a Gaussian | PSNR lost, dB | write, ms | read, ms |");
    println!("|---|---|---|---|---|---|");
    let folder = std::env::temp_dir().join(format!("measure-formats-{}", std::process::id()));
    for format in Format::ALL {
        let path = folder.join(format!("scene.{}", format.extension()));
        let write = least(|| write_scene(&path, &scene).map(|_| ()))?;
        let read = least(|| read_scene(&path).map(|_| ()))?;
        let bytes = std::fs::metadata(&path)?.len();
        let lost = reference - psnr(&read_scene(&path)?.gaussians, &window, &mut rasterizer)?;
        let each = bytes as f64 / scene.len() as f64;
        println!("| {format} | {bytes} | {each:.1} | {lost:.3} | {write:.1} | {read:.1} |");
    }
    std::fs::remove_dir_all(folder)?;
    for path in std::env::args().skip(2) {
        let scene = read_scene(path.as_ref())?.gaussians;
        println!("{path}: {} Gaussians, PSNR {:.3} dB", scene.len(), psnr(&scene, &window, &mut rasterizer)?);
    }
    Ok(())
}

/// Mean over the held-out views.
fn psnr(scene: &Gaussians, window: &Window, rasterizer: &mut Rasterizer) -> Result<f64, Box<dyn Error>> {
    let mut sum = 0.0;
    for target in &window.targets {
        let image = render_view(rasterizer, scene, target.camera())?.image;
        sum += image_metrics::psnr(target.image(), &image)?;
    }
    Ok(sum / window.targets.len() as f64)
}

/// Milliseconds.
fn least<E>(mut work: impl FnMut() -> Result<(), E>) -> Result<f64, E> {
    let mut least = f64::INFINITY;
    for _ in 0..REPEATS {
        let begin = Instant::now();
        work()?;
        least = least.min(begin.elapsed().as_secs_f64() * 1e3);
    }
    Ok(least)
}
