//! Checks a renderer on golden cases in the layout of `fixtures/gs-raster`:
//! `cargo run --release -p gs-raster --example check_case -- [--device cpu|reference] FILE…`.
//! Exits with 1 outside tolerance, with 2 for bad arguments and files that are no golden cases.

#[path = "../tests/it/check.rs"]
mod check;

use gs_reference::Case;
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
    let judge = match device.as_str() {
        "cpu" => check::check_cpu,
        "reference" => check::check_reference,
        other => {
            eprintln!("device {other:?} is not known, expected cpu or reference");
            return ExitCode::from(2);
        }
    };
    if files.is_empty() {
        eprintln!("expected at least one file");
        return ExitCode::from(2);
    }
    let mut outside = 0;
    println!("{:<40} {:<6} {:>9} {:>9} {:>9}", "case", "output", "max error", "bound", "rel. L2");
    for file in files {
        let case = match Case::read(file.as_ref()) {
            Ok(case) => case,
            Err(error) => {
                eprintln!("{error}");
                let mut cause = std::error::Error::source(&error);
                while let Some(error) = cause {
                    eprintln!("  because: {error}");
                    cause = error.source();
                }
                return ExitCode::from(2);
            }
        };
        let name = file.rsplit('/').next().unwrap_or(&file);
        for row in judge(&case) {
            let (output, bound) = (row.output, row.bound);
            let verdict = if row.holds() { "" } else { "OUTSIDE" };
            outside += usize::from(!row.holds());
            match row.deviation {
                Ok(d) => {
                    let (max, l2) = (d.max_abs, d.relative_l2);
                    println!("{name:<40} {output:<6} {max:>9.1e} {bound:>9.1e} {l2:>9.1e} {verdict}");
                }
                Err(mismatch) => println!("{name:<40} {output:<6} {mismatch} {verdict}"),
            }
        }
    }
    if outside == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
