//! Checks LPIPS on files of picture pairs in the layout of `fixtures/image-metrics/lpips.safetensors`, with weights by its
//! rule, or with given ones:
//! `cargo run --release -p image-metrics --features lpips --example check_lpips -- [--weights FILE]… FILE…`.
//! Exits with 1 outside tolerance, or if a file expects nothing of the networks.

#[path = "../tests/it/recipe.rs"]
mod recipe;

use image_metrics::Lpips;
use std::path::PathBuf;

fn main() -> std::process::ExitCode {
    let (mut weights, mut files): (Vec<PathBuf>, Vec<PathBuf>) = (Vec::new(), vec![]);
    let mut arguments = std::env::args().skip(1);
    while let Some(word) = arguments.next() {
        match word.as_str() {
            "--weights" => weights.extend(arguments.next().map(PathBuf::from)),
            _ => files.push(word.into()),
        }
    }
    if files.is_empty() {
        files.push(recipe::fixture());
    }
    let networks: Vec<Lpips> = if weights.is_empty() {
        recipe::NETWORKS.into_iter().map(recipe::lpips).collect()
    } else {
        match Lpips::read(&weights) {
            Ok(lpips) => vec![lpips],
            Err(error) => {
                eprintln!("error: {error}");
                return 2.into();
            }
        }
    };
    let mut good = true;
    for file in &files {
        let cases: Vec<_> = networks.iter().flat_map(|lpips| recipe::cases(file, lpips)).collect();
        good &= !cases.is_empty();
        println!("{}: {} cases", file.display(), cases.len());
        for case in cases {
            good &= case.holds();
            let verdict = if case.holds() { "" } else { " FAILED" };
            println!("  {:24} off by {:.1e}{verdict}", case.name, case.deviation());
        }
    }
    if good { 0.into() } else { 1.into() }
}
