//! `doctor`: what this machine offers, and whether the renderer computes what it should, on the CPU and on the GPU.

mod gpu;

use crate::arguments::Common;
use crate::checkpoints;
use crate::failure::{Failure, OrFail, Outcome};
use crate::summary::print_line;
use crate::{output, threads};
use clap::Args;
use cpu_isa::Isa;
use evaluate::{Machine, Recipe, render_view};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians, Intrinsics, dc_from_rgb, logit};
use serde::Serialize;

/// Show what this machine and this build offer, and run a self-test
#[derive(Debug, Args)]
pub(crate) struct Arguments {}

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    recipe: Recipe<()>,
    /// The instruction sets of the processor that there is vector code for.
    simd: Vec<&'static str>,
    /// The adapter that `--device auto` renders on; none is the CPU.
    gpu: Option<String>,
    #[serde(flatten)]
    gpus: gpu::Gpus,
    self_test_error: f32,
    passed: bool,
}

/// Largest deviation of a channel from its closed form that passes.
const TOLERANCE: f32 = 1e-5;

pub(crate) fn run(_: &Arguments, common: &Common) -> Outcome {
    let Machine { os, arch, cpu, cores, memory_bytes } = Machine::this();
    let error = self_test()?;
    let passed = error <= TOLERANCE;
    let gpus = gpu::examine(common.device);
    let memory = memory_bytes.map_or("unknown".to_owned(), |bytes| format!("{:.1} GB", bytes as f64 / 1e9));
    let verdict = if passed { "passed" } else { "FAILED" };
    let mut lines = vec![
        format!("version    sparsesplat {}", env!("CARGO_PKG_VERSION")),
        format!("system     {os} {arch}"),
        format!(
            "processor  {}, {cores} cores, {} threads work",
            cpu.as_deref().unwrap_or("unknown"),
            threads()
        ),
        vectors_line(),
        format!("memory     {memory}"),
        "heads      two for --backbone plane-sweep are built in, the default and --head attention; --weights takes others that `train` wrote"
            .to_owned(),
        networks_line(),
        "LPIPS      is measured where --lpips-weights names its files; none come along, none are looked for"
            .to_owned(),
        "data       none needed for `demo`; other commands take folders by their path".to_owned(),
        format!(
            "self-test  {verdict}: a scene rendered on the CPU is off its closed form by {error:.1e}, {TOLERANCE:.0e} \
             allowed"
        ),
    ];
    lines.extend(gpus.lines());
    lines.iter().for_each(|line| print_line(line));
    let gpu_failed = gpus.failed();
    if let Some(path) = &common.json {
        let recipe = crate::recipe(0, ());
        let simd = Isa::available().into_iter().map(Isa::name).collect();
        let gpu = gpus.automatic().map(str::to_owned);
        let passed = passed && !gpu_failed;
        output::write_json(path, &Record { recipe, simd, gpu, gpus, self_test_error: error, passed })?;
    }
    match (passed, gpu_failed) {
        (true, false) => Ok(()),
        (false, _) => Err(Failure::work("the renderer does not compute what it should on this machine")),
        (true, true) => Err(Failure::work(
            "the GPU does not do what it should: commands render on the CPU until its driver is mended",
        )),
    }
}

/// Where weights of DepthSplat's network are looked for, and which are there.
fn networks_line() -> String {
    let Some(folder) = checkpoints::folder() else {
        return format!(
            "networks   the system names no home folder: set {}, or give --weights",
            checkpoints::VARIABLE
        );
    };
    let found = checkpoints::present(&folder);
    let names: Vec<&str> = found.iter().map(|(checkpoint, _)| checkpoint.name).collect();
    let found =
        if names.is_empty() { "none there".to_owned() } else { format!("there: {}", names.join(", ")) };
    let line = format!(
        "networks   weights for --backbone depthsplat are looked for in {} ({found}); `weights` lists what is published",
        folder.display()
    );
    #[cfg(not(feature = "candle"))]
    let line = format!(
        "{line}\n           this binary is built without candle, which they need; {}",
        crate::WITH_CANDLE
    );
    line
}

/// The instruction sets that the processor has, and which of them vector code runs on.
fn vectors_line() -> String {
    let available: Vec<&str> = Isa::available().into_iter().map(Isa::name).collect();
    format!(
        "vectors    {}; this processor has {}, and {} forces one of them",
        Isa::in_use(),
        available.join(", "),
        cpu_isa::VARIABLE
    )
}

/// Colours of the test scene along the middle row, from its centre: red, blue. On the optical axis a footprint is a
/// circle of variance (f σ / z)² + 0.3 square pixels, so these follow from 0.6 exp(-d²/8.6) over 0.9 exp(-d²/32.6).
const EXPECTED: [(usize, [f32; 2]); 3] =
    [(0, [0.6, 0.36]), (3, [0.210_696_36, 0.539_000_75]), (6, [0.009_123_77, 0.295_578_55])];

/// Renders two Gaussians on the optical axis, and returns by how much the colours miss their closed form.
fn self_test() -> Outcome<f32> {
    let lens = Intrinsics { fx: 20.0, fy: 20.0, cx: 8.5, cy: 8.5, width: 17, height: 17 };
    let camera = Camera::looking_at(lens, glam::DVec3::ZERO, glam::DVec3::Z, glam::DVec3::NEG_Y).or_work()?;
    let mut scene = Gaussians::empty(0).or_work()?;
    for (z, sigma, opacity, rgb) in [(5.0, 1.0_f32, 0.9, [0.0, 0.0, 1.0]), (4.0, 0.4, 0.6, [1.0, 0.0, 0.0])] {
        let log_scale = [sigma.ln(); 3];
        scene.push([0.0, 0.0, z], [1.0, 0.0, 0.0, 0.0], log_scale, logit(opacity), &dc_from_rgb(rgb));
    }
    let image = render_view(&mut Rasterizer::cpu(), &scene, &camera).or_work()?.image;
    let miss = EXPECTED.iter().flat_map(|&(d, [red, blue])| {
        let [r, g, b] = image.pixel(8 + d, 8);
        [(r - red).abs(), g.abs(), (b - blue).abs()]
    });
    // A NaN must not pass: `f32::max` would drop it.
    Ok(miss.fold(0.0, |worst, error| if error <= worst { worst } else { error }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expected_colours_follow_from_the_formula() {
        for (d, [red, blue]) in EXPECTED {
            let square = (d * d) as f64;
            let (near, far) = (0.6 * (-square / 8.6).exp(), 0.9 * (-square / 32.6).exp());
            assert!((near - f64::from(red)).abs() < 1e-6, "{d}: {near}");
            assert!(((1.0 - near) * far - f64::from(blue)).abs() < 1e-6, "{d}: {}", (1.0 - near) * far);
        }
    }

    #[test]
    fn the_renderer_passes() {
        assert!(self_test().unwrap() <= TOLERANCE);
    }
}
