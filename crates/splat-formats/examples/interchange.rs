//! Our half of `cargo xtask format-test`: `interchange write DIR` writes a scene in every format, `interchange compare DIR` holds what
//! another program made of it against the scene.

#[path = "../tests/it/difference.rs"]
#[expect(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]
mod difference;

use difference::{Difference, difference, ordered_as, scene, turn};
use gs_scene::{Gaussians, SH_C0};
use splat_formats::{Format, HalfTurn, half_turn, read_scene, write_scene};
use std::error::Error;
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // SH of all degrees; as many Gaussians as leave the last chunk of compressed PLY incomplete.
    let scene = scene(3, 1000, 27);
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["write", folder] => {
            for format in Format::ALL {
                write_scene(&Path::new(folder).join(format!("ours.{}", format.extension())), &scene)?;
            }
            Ok(())
        }
        ["compare", folder] => compare(Path::new(folder), &scene),
        _ => Err("usage: interchange write|compare DIR".into()),
    }
}

fn compare(folder: &Path, scene: &Gaussians) -> Result<(), Box<dyn Error>> {
    // The other program does not convert the axes of SPZ.
    let mut upside_down = scene.clone();
    half_turn(&mut upside_down, HalfTurn::X);
    let byte = 0.5 / 255.0;
    let spz = Difference {
        position: 0.5 / 2_f64.powi(18),
        log_scale: 0.5 / 16.0,
        angle: turn(0.5 * FRAC_1_SQRT_2 / 511.0),
        opacity: byte,
        colour: byte / 0.15 * f64::from(SH_C0),
        sh: 0.5 / 128.0,
    };
    // It keeps 12 fractional bits of positions, and 4 bits of SH: to the nearest of 128ths, then of 8ths.
    let their_spz = Difference { position: 0.5 / 2_f64.powi(12), sh: 8.5 / 128.0, ..spz };
    let compressed = Difference {
        // Chunks span at most 60 units, and 12 in log-scales.
        position: 0.5 * 60.0 / 1023.0,
        log_scale: 0.5 * 12.0 / 1023.0,
        angle: turn(0.5 * SQRT_2 / 1023.0),
        opacity: byte,
        colour: byte,
        sh: 0.5 / 32.0,
    };
    let splat = Difference {
        // Our bytes are 128 q + 128; it reads them as 127.5 q + 127.5.
        angle: 4.0 * (0.5 * 2.0 * (1.0 / 128.0 + byte)).asin(),
        opacity: byte,
        colour: byte,
        ..Difference::default()
    };
    let mut problems = 0;
    for (file, expected, bound) in [
        ("theirs.compressed.ply", scene, compressed),
        ("theirs.spz", &upside_down, their_spz),
        ("theirs.glb", scene, Difference::default()),
        ("from-ply.ply", scene, Difference::default()),
        ("from-compressed.ply", scene, compressed),
        ("from-spz.ply", &upside_down, spz),
        ("from-splat.ply", scene, splat),
    ] {
        let read = read_scene(&folder.join(file))?;
        let ordered = ordered_as(expected, &read.gaussians);
        let found = difference(&ordered, &read.gaussians);
        println!("{file:<22} {} Gaussians, {}: {found:?}", read.gaussians.len(), read.format);
        let count =
            if read.gaussians.len() == scene.len() { Ok(()) } else { Err("another count".to_owned()) };
        if let Err(problem) = count.and_then(|()| found.within(&bound)) {
            println!("{file}: {problem}");
            problems += 1;
        }
    }
    if problems > 0 {
        Err(format!("{problems} files differ by more than their format's steps").into())
    } else {
        Ok(())
    }
}
