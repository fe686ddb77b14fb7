//! Prints what the renderers make of the cases that break renderers, as the table of docs/numerics.md:
//! `cargo run --release -p gs-raster --example hard_cases [-- --write docs/numerics.md]`. With `--write` the lines between the
//! marks in that file are replaced. Exits with 1 if a result is outside its bound, with 2 for bad arguments or files.

#[expect(dead_code, reason = "the rest serves tests")]
#[path = "../tests/it/check.rs"]
mod check;
#[path = "../tests/it/fixtures.rs"]
mod fixtures;
#[path = "../tests/it/hard_case.rs"]
mod hard_case;
#[path = "../tests/it/hard_cases.rs"]
mod hard_cases;
#[path = "../tests/it/losses.rs"]
mod losses;

use check::Row;
use gs_raster::{Device, Rasterizer};
use gs_reference::tolerance::F32_RANDOM_GRADIENT;
use std::process::ExitCode;

const BEGIN: &str = "<!-- hard cases: begin -->";
const END: &str = "<!-- hard cases: end -->";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let file = match arguments.as_slice() {
        [] => None,
        [flag, file] if flag == "--write" => Some(file),
        _ => return refused("expected nothing, or --write FILE"),
    };
    let mut cpu = Rasterizer::cpu();
    let mut gpu = Rasterizer::new(Device::Gpu);
    let mut lines = vec![match gpu.as_ref() {
        Ok(gpu) => adapter(gpu),
        Err(error) => format!("GPU: not measured ({error})."),
    }];
    lines.extend([
        String::new(),
        "| case | what happens | image, CPU | image, GPU | gradients, CPU | gradients, GPU |".to_owned(),
        "|---|---|---|---|---|---|".to_owned(),
    ]);
    let mut outside = 0;
    for case in hard_cases::hard_cases() {
        let on_cpu = Some(case.measure(&mut cpu));
        let on_gpu = gpu.as_mut().ok().map(|gpu| case.measure(gpu));
        let both = [&on_cpu, &on_gpu];
        for (device, found) in ["CPU", "GPU"].into_iter().zip(both) {
            for complaint in found.iter().flat_map(|found| case.complaints(found)) {
                eprintln!("{} on the {device}: {complaint}", case.name);
                outside += 1;
            }
        }
        let [cpu_image, gpu_image] =
            both.map(|found| cell(found.as_ref().map(|found| worst(&found.pictures[..1], image_scale))));
        let [cpu_gradients, gpu_gradients] =
            both.map(|found| cell(found.as_ref().map(|found| worst(&found.gradients, gradient_scale))));
        lines.push(format!(
            "| {} | {} | {cpu_image} | {gpu_image} | {cpu_gradients} | {gpu_gradients} |",
            case.name, case.happens
        ));
    }
    let table = lines.join("\n");
    match file {
        None => println!("{table}"),
        Some(file) => {
            if let Err(message) = write_between_marks(file, &table) {
                return refused(&message);
            }
        }
    }
    if outside == 0 {
        return ExitCode::SUCCESS;
    }
    eprintln!("{outside} outside tolerance");
    ExitCode::FAILURE
}

#[cfg(feature = "gpu")]
fn adapter(gpu: &Rasterizer) -> String {
    let about = gpu.adapter().expect("it renders on a GPU");
    format!("GPU: {} ({}, {}, {}).", about.name, about.kind, about.backend, about.driver)
}

#[cfg(not(feature = "gpu"))]
fn adapter(_: &Rasterizer) -> String {
    unreachable!("a build without a graphics interface has no GPU")
}

/// Relative to the largest value of the image, at least 1.
fn image_scale(row: &Row) -> f64 {
    row.deviation.as_ref().map_or(f64::NAN, |deviation| deviation.largest.max(1.0))
}

/// Relative to the largest sum of magnitudes that parts of the picture add, of which the bound is a share; at least 5e-3.
fn gradient_scale(row: &Row) -> f64 {
    row.bound / F32_RANDOM_GRADIENT
}

/// Largest deviation relative to a scale; NaN if there is anything that cannot be compared.
fn worst(rows: &[Row], scale: fn(&Row) -> f64) -> f64 {
    let errors = rows.iter().map(|row| row.deviation.as_ref().map_or(f64::NAN, |d| d.max_abs) / scale(row));
    errors.fold(0.0, |a, b| if a >= b { a } else { b })
}

fn cell(error: Option<f64>) -> String {
    match error {
        None => "not measured".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(error) => format!("{error:.0e}"),
    }
}

/// Replaces what stands between the marks of a file.
fn write_between_marks(file: &str, table: &str) -> Result<(), String> {
    let text = std::fs::read_to_string(file).map_err(|error| format!("cannot read {file}: {error}"))?;
    let (Some(begin), Some(end)) = (text.find(BEGIN), text.find(END)) else {
        return Err(format!("{file} does not have the lines {BEGIN} and {END}"));
    };
    let (before, after) = (text.get(..begin + BEGIN.len()), text.get(end..));
    let (Some(before), Some(after)) = (before, after.filter(|_| begin < end)) else {
        return Err(format!("{file} has {END} before {BEGIN}"));
    };
    let text = format!("{before}\n{table}\n{after}");
    gs_scene::write_atomically(file.as_ref(), |out| out.write_all(text.as_bytes()))
        .map_err(|error| format!("cannot write {file}: {error}"))
}

fn refused(message: &str) -> ExitCode {
    eprintln!("error: {message}");
    ExitCode::from(2)
}
