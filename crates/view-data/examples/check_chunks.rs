//! Compares what is read of a folder of chunks with its `expected.json`: `check_chunks -- FOLDER`, where the file has, by
//! scene, `cameras` (the 18 numbers of each row), `image_bytes` and `first_bytes` of each picture. Exits with 1 if
//! anything differs, or a scene is missing on either side.
//!
//! Intrinsics must agree to 1e-12 (the numbers are the file's), poses to 2e-6 times the largest number of the row: the
//! nearest rotation moves f32 entries by some 1e-7. Every picture is decoded.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;
use view_data::{Dataset, Frame, ImageSource, open_chunks};

#[derive(Deserialize)]
struct Expected {
    cameras: Vec<[f64; 18]>,
    image_bytes: Vec<u64>,
    first_bytes: Vec<Vec<u8>>,
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: check_chunks FOLDER")?;
    let folder = Path::new(&folder);
    let expected: BTreeMap<String, Expected> =
        serde_json::from_slice(&std::fs::read(folder.join("expected.json"))?)?;
    let start = Instant::now();
    let scenes = open_chunks(folder)?;
    let opened = start.elapsed();
    let mut differences: Vec<String> =
        scenes.dropped.iter().map(|dropped| format!("{} dropped: {}", dropped.key, dropped.reason)).collect();
    for key in expected.keys().filter(|key| scenes.scenes.iter().all(|scene| scene.name != **key)) {
        differences.push(format!("{key}: not read"));
    }
    let (mut frames, mut worst) = (0, 0.0);
    for scene in &scenes.scenes {
        match expected.get(&scene.name) {
            Some(expected) => compare(scene, expected, &mut worst, &mut differences)?,
            None => differences.push(format!("{}: not expected", scene.name)),
        }
        frames += scene.frames.len();
    }
    println!(
        "{} scenes, {frames} frames, opened in {opened:.1?}, largest deviation of a pose {worst:.1e} (limit {POSE:.0e}), {} differences",
        scenes.scenes.len(),
        differences.len()
    );
    for difference in &differences {
        println!("{difference}");
    }
    Ok(if differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Of normalised intrinsics.
const INTRINSICS: f64 = 1e-12;
/// Of a pose, as a share of the largest number of its row.
const POSE: f64 = 2e-6;

fn compare(
    scene: &Dataset,
    expected: &Expected,
    worst: &mut f64,
    differences: &mut Vec<String>,
) -> Result<(), Box<dyn Error>> {
    let counts = [expected.cameras.len(), expected.image_bytes.len(), expected.first_bytes.len()];
    if counts != [scene.frames.len(); 3] {
        differences.push(format!("{}: {} frames, expected {counts:?}", scene.name, scene.frames.len()));
        return Ok(());
    }
    for (position, frame) in scene.frames.iter().enumerate() {
        let place = format!("{}, frame {position}", scene.name);
        let ImageSource::Encoded { path, offset, length } = &frame.image else {
            return Err(format!("{place}: picture is not in the chunk").into());
        };
        let first = &expected.first_bytes[position];
        let mut bytes = vec![0; first.len()];
        let mut file = std::fs::File::open(path)?;
        file.seek(SeekFrom::Start(*offset))?;
        file.read_exact(&mut bytes)?;
        if bytes != *first || *length != expected.image_bytes[position] {
            differences.push(format!("{place}: {length} bytes, begins {bytes:?}, expected {first:?}"));
        }
        let (found, row) = (row_of(frame), &expected.cameras[position]);
        let scale = row[6..].iter().fold(1.0, |largest: f64, value| largest.max(value.abs()));
        let deviation =
            |range: std::ops::Range<usize>| range.map(|at| (found[at] - row[at]).abs()).fold(0.0, f64::max);
        let (intrinsics, pose) = (deviation(0..6), deviation(6..18) / scale);
        *worst = worst.max(pose);
        if !(intrinsics <= INTRINSICS && pose <= POSE) {
            differences.push(format!("{place}: intrinsics off by {intrinsics:.1e}, pose by {pose:.1e}"));
        }
        scene.load_views(&[position], None)?;
    }
    Ok(())
}

/// The camera as the chunk's row would have it.
fn row_of(frame: &Frame) -> [f64; 18] {
    let intrinsics = frame.lens.intrinsics;
    let (width, height) = (intrinsics.width as f64, intrinsics.height as f64);
    let mut row = [0.0; 18];
    row[0] = intrinsics.fx / width;
    row[1] = intrinsics.fy / height;
    row[2] = intrinsics.cx / width;
    row[3] = intrinsics.cy / height;
    let rotation = frame.axes.transpose();
    let translation = -(rotation * frame.position);
    for r in 0..3 {
        let values = rotation.row(r).extend(translation[r]).to_array();
        row[6 + 4 * r..10 + 4 * r].copy_from_slice(&values);
    }
    row
}
