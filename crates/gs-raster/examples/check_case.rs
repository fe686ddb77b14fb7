//! Checks a renderer on golden cases in the layout of `fixtures/gs-raster`, outputs and gradients:
//! `cargo run --release -p gs-raster --example check_case -- [--device cpu|gpu|reference] FILE…`.
//! Exits with 1 outside tolerance, with 2 for bad arguments or files.

#[path = "../tests/it/check.rs"]
mod check;

use check::Row;
use gs_raster::{Device, Rasterizer};
use gs_reference::Case;
use std::error::Error;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut device = "cpu".to_owned();
    let mut files = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        if argument == "--device" {
            device = arguments.next().unwrap_or_default();
        } else {
            files.push(argument);
        }
    }
    if files.is_empty() {
        return refused("expected at least one file");
    }
    let rasterizer = match device.as_str() {
        "cpu" => Rasterizer::new(Device::Cpu).map(Some),
        "gpu" => Rasterizer::new(Device::Gpu).map(Some),
        "reference" => Ok(None),
        other => return refused(&format!("device {other:?} is not known, expected cpu, gpu or reference")),
    };
    let mut rasterizer = match rasterizer {
        Ok(rasterizer) => rasterizer,
        Err(error) => return refused(&with_causes(&error)),
    };
    #[cfg(feature = "gpu")]
    if let Some(adapter) = rasterizer.as_ref().and_then(Rasterizer::adapter) {
        println!("{} ({}, {}, {})", adapter.name, adapter.kind, adapter.backend, adapter.driver);
    }

    let mut outside = 0;
    println!(
        "{:<24} {:<24} {:>9} {:>9} {:>9} {:>9} {:>12}",
        "case", "output", "max error", "bound", "largest", "rel. L2", "cosine"
    );
    for file in files {
        let case = match Case::read(file.as_ref()) {
            Ok(case) => case,
            Err(error) => return refused(&with_causes(&error)),
        };
        let name = std::path::Path::new(&file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let rows = match &mut rasterizer {
            Some(rasterizer) => match check::check_rasterizer(&case, rasterizer) {
                Ok(rows) => rows,
                Err(error) => return refused(&format!("{file}: {}", with_causes(&error))),
            },
            None => check::check_reference(&case),
        };
        for row in rows {
            outside += usize::from(!row.holds() && !row.is_empty());
            print_row(&name, &row);
        }
    }
    println!("{outside} outside tolerance");
    if outside == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn print_row(case: &str, row: &Row) {
    let (output, bound, verdict) =
        (&row.output, row.bound, if row.holds() || row.is_empty() { "" } else { "OUTSIDE" });
    match &row.deviation {
        Ok(d) => println!(
            "{case:<24} {output:<24} {:>9.1e} {bound:>9.1e} {:>9.1e} {:>9.1e} {:>12.9} {verdict}",
            d.max_abs, d.largest, d.relative_l2, d.cosine
        ),
        Err(mismatch) => println!("{case:<24} {output:<24} {mismatch} {verdict}"),
    }
}

fn with_causes(error: &dyn Error) -> String {
    let (mut text, mut cause) = (error.to_string(), error.source());
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

fn refused(message: &str) -> ExitCode {
    eprintln!("error: {message}");
    ExitCode::from(2)
}
