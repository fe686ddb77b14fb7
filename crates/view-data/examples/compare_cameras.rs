//! Compares the cameras of one scene in two layouts, frame by frame by name, and exits with 1 if they differ.
//!
//! `cargo run --release -p view-data --example compare_cameras -- PATH FORMAT PATH FORMAT [TOLERANCE]`

use std::path::Path;
use view_data::{Dataset, open};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [first, first_format, second, second_format, rest @ ..] = arguments.as_slice() else {
        return Err("usage: compare_cameras PATH FORMAT PATH FORMAT [TOLERANCE]".into());
    };
    let tolerance: f64 = rest.first().map_or(Ok(1e-5), |word| word.parse())?;
    let first = open(Path::new(first), Some(first_format.parse()?))?;
    let second = open(Path::new(second), Some(second_format.parse()?))?;
    for dataset in [&first, &second] {
        println!("{} as {}: {} frames", dataset.name, dataset.format, dataset.frames.len());
        for entry in &dataset.dropped {
            println!("  {}: {}", entry.key, entry.reason);
        }
        print_points(dataset)?;
    }
    let names = |dataset: &Dataset| dataset.frames.iter().map(|f| f.name.clone()).collect::<Vec<_>>();
    if names(&first) != names(&second) {
        return Err("the frames differ in name or order".into());
    }
    let (mut turn, mut shift, mut lens) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (a, b) in first.frames.iter().zip(&second.frames) {
        let difference = a.axes - b.axes;
        turn = difference.to_cols_array().into_iter().fold(turn, |worst, entry| worst.max(entry.abs()));
        shift = shift.max((a.position - b.position).length());
        let (a, b) = (a.lens.intrinsics, b.lens.intrinsics);
        for (x, y) in [(a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy)] {
            lens = lens.max((x - y).abs());
        }
        if (a.width, a.height) != (b.width, b.height) {
            return Err("the pictures differ in size".into());
        }
    }
    println!("largest difference: rotation entry {turn:.2e}, position {shift:.2e}, intrinsics {lens:.2e} px");
    if turn.max(shift).max(lens) > tolerance { Err("cameras differ".into()) } else { Ok(()) }
}

/// Mean distance between where points are seen and where the frame's lens would see them.
fn print_points(dataset: &Dataset) -> Result<(), Box<dyn std::error::Error>> {
    let Some(points) = dataset.points()? else { return Ok(()) };
    let cameras = dataset.cameras()?;
    let (mut sum, mut count) = (0.0, 0_usize);
    for point in &points {
        for seen in &point.observations {
            let place = cameras[seen.frame].to_camera(point.position);
            let expected = dataset.frames[seen.frame].lens.distort(place.truncate() / place.z);
            sum += expected.distance(seen.pixel);
            count += 1;
        }
    }
    println!(
        "  {} points, {count} sightings, mean reprojection error {:.4} px",
        points.len(),
        sum / count as f64
    );
    Ok(())
}
