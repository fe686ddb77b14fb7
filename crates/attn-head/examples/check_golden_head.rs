//! Compares the attention head with golden files of another implementation, every map and gradient:
//!
//! `cargo run --release -p attn-head --features candle --example check_golden_head -- FILE.safetensors ..`
//!
//! The exit status is 1 if anything is outside the tolerances, 2 if a file cannot be read.

#[path = "../tests/it/golden/layout.rs"]
mod layout;

use layout::{Failure, Golden};
use std::process::ExitCode;

fn check(path: &str) -> Result<bool, Failure> {
    let golden = Golden::read(&std::fs::read(path)?)?;
    let config = golden.weights.config;
    println!("{path}: {} anchors, {} neighbours, {} image features", golden.n, golden.k, config.image);
    println!("{:6} {:15} {:>9} {:>9} {:>9}", "by", "map", "max abs", "rms", "largest");
    let mut good = true;
    for d in golden.compare()? {
        let verdict = if d.within() { "" } else { "  OUTSIDE" };
        println!("{:6} {:15} {:9.1e} {:9.1e} {:9.1e}{verdict}", d.by, d.name, d.absolute, d.rms, d.largest);
        good &= d.within();
    }
    println!(
        "relative rms allowed {:.0e}, largest {:.0e} of the map's rms: {}\n",
        layout::RMS,
        layout::LARGEST,
        if good { "good" } else { "OUTSIDE" }
    );
    Ok(good)
}

fn main() -> ExitCode {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    if paths.is_empty() {
        eprintln!("usage: check_golden_head FILE.safetensors ..");
        return ExitCode::from(2);
    }
    let (mut good, mut readable) = (true, true);
    for path in paths {
        match check(&path) {
            Ok(within) => good &= within,
            Err(failure) => {
                eprintln!("{path}: {failure}");
                readable = false;
            }
        }
    }
    match (readable, good) {
        (false, _) => ExitCode::from(2),
        (true, false) => ExitCode::FAILURE,
        (true, true) => ExitCode::SUCCESS,
    }
}
