//! Compares every map between the network's stages with golden files of another implementation:
//!
//! `cargo run --release -p depth-backbone --features depthsplat --example check_golden_depthsplat -- FILE.safetensors ..`
//!
//! With `--weights CHECKPOINT` before the files, the network of a checkpoint takes the place of the weights by rule.
//!
//! The exit status is 1 if any map is outside the tolerances, or was not computed.

#[path = "../tests/it/depthsplat/golden.rs"]
mod golden;

use depth_backbone::DepthSplat;
use golden::{Deviation, Failure, Golden};
use std::process::ExitCode;

/// Relative root mean square of a map.
const RMS: f64 = 2e-5;
/// Relative error of the final depth, everywhere.
const DEPTH: f64 = 1e-4;
/// Largest error of a map in units of its root mean square.
const LARGEST: f64 = 5e-4;

fn within(d: &Deviation) -> bool {
    // Written so that NaN is outside.
    let depth = d.name != "depth.final" || d.relative <= DEPTH;
    d.rms <= RMS && d.largest <= LARGEST && d.channels <= 10.0 * RMS && depth
}

fn check(path: &str, weights: Option<&str>) -> Result<bool, Failure> {
    let golden = Golden::read(&std::fs::read(path)?)?;
    let first = &golden.views[0];
    let (width, height) = (first.image().width(), first.image().height());
    println!("{path}: {}, {} views of {width}x{height}", golden.variant, golden.views.len());
    let network = match weights {
        Some(weights) => DepthSplat::open(weights)?,
        None => DepthSplat::untrained(golden.variant, &golden.salt)?,
    };
    println!("{:28} {:>9} {:>9} {:>9}", "map", "rms", "largest", "channels");
    let (mut good, mut worst) = (true, 0.0_f64);
    for (name, deviation) in golden.compare(&network)? {
        match deviation {
            Some(d) => {
                let verdict = if within(&d) { "" } else { "  OUTSIDE" };
                println!("{name:28} {:9.1e} {:9.1e} {:9.1e}{verdict}", d.rms, d.largest, d.channels);
                if name == "depth.final" {
                    println!("{:28} {:>9} {:9.1e}", "  relative to the depth", "", d.relative);
                }
                good &= within(&d);
                worst = worst.max(d.rms);
            }
            None => {
                println!("{name:28} not computed  OUTSIDE");
                good = false;
            }
        }
    }
    println!("worst relative rms {worst:.1e}: {}\n", if good { "good" } else { "OUTSIDE" });
    Ok(good)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (weights, paths) = match arguments.as_slice() {
        [option, weights, paths @ ..] if option == "--weights" => (Some(weights.as_str()), paths),
        paths => (None, paths),
    };
    if paths.is_empty() {
        eprintln!("usage: check_golden_depthsplat [--weights CHECKPOINT] FILE.safetensors ..");
        return ExitCode::from(2);
    }
    let mut good = true;
    for path in paths {
        match check(path, weights) {
            Ok(within) => good &= within,
            Err(failure) => {
                eprintln!("{path}: {failure}");
                good = false;
            }
        }
    }
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
