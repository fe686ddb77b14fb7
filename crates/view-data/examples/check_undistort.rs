//! Compares directions of pixels with those that other software found, and exits with 1 if they differ.
//!
//! `cargo run --release -p view-data --example check_undistort -- FILE`: a JSON file `{"points": [{"pixel": [x, y],
//! "normalised": [x/z, y/z]}, ..]}` beside the data set (pixel centres at +0.5, OpenCV axes), for its first frame.

use glam::DVec2;
use serde_json::Value;
use std::path::Path;
use view_data::open;

/// Largest distance that agrees, pixels.
const TOLERANCE: f64 = 1e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: check_undistort FILE")?;
    let golden: Value = serde_json::from_slice(&std::fs::read(&file)?)?;
    let points = golden["points"].as_array().ok_or("no list \"points\"")?;
    let folder = Path::new(&file).parent().filter(|folder| !folder.as_os_str().is_empty());
    let dataset = open(folder.unwrap_or(Path::new(".")), None)?;
    let lens = dataset.frame(0)?.lens;
    let (mut there, mut back) = (0.0_f64, 0.0_f64);
    for point in points {
        let pair = |key: &str| Some(DVec2::new(point[key][0].as_f64()?, point[key][1].as_f64()?));
        let pixel = pair("pixel").ok_or("a point without pixel")?;
        let direction = pair("normalised").ok_or("a point without direction")?;
        let found = lens.undistort(pixel).ok_or(format!("no direction is seen at {pixel}"))?;
        let focal = DVec2::new(lens.intrinsics.fx, lens.intrinsics.fy);
        there = there.max(((found - direction) * focal).length());
        back = back.max((lens.distort(direction) - pixel).length());
    }
    println!("{} points; farthest: undistorted {there:.2e} px, distorted {back:.2e} px", points.len());
    if points.is_empty() || there.max(back) > TOLERANCE { Err("the lenses differ".into()) } else { Ok(()) }
}
