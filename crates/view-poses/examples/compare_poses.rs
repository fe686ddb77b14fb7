//! Compares a data set of estimated poses with one of given poses: `compare_poses GIVEN ESTIMATED`.
//!
//! Frames are joined by name. The estimated cameras are moved, turned and scaled onto the given ones (least squares, Umeyama 1991). Prints the
//! share of the frames that have a pose, errors of rotation (degrees) and position (% of the extent of the given cameras: their largest
//! distance from their mean), and the ratio of the focal lengths.

use glam::{DMat3, DQuat, DVec3};
use std::path::Path;
use view_data::{Frame, open};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [given, estimated] = &arguments[..] else {
        return Err("usage: compare_poses GIVEN ESTIMATED (two data sets)".into());
    };
    let (given, estimated) = (open(Path::new(given), None)?, open(Path::new(estimated), None)?);
    let mut pairs: Vec<(&Frame, &Frame)> = Vec::new();
    for frame in &estimated.frames {
        pairs.extend(given.frames.iter().find(|other| other.name == frame.name).map(|other| (other, frame)));
    }
    if pairs.len() < 3 {
        return Err(format!("{} common frames, expected at least 3", pairs.len()).into());
    }
    let (rotation, scale, move_by) = align(&pairs).ok_or("the cameras stand in one place or on one line")?;
    let mean = pairs.iter().map(|(given, _)| given.position).sum::<DVec3>() / pairs.len() as f64;
    let extent = pairs.iter().map(|(given, _)| (given.position - mean).length()).fold(0.0, f64::max);
    let mut turned: Vec<f64> = Vec::new();
    let mut moved: Vec<f64> = Vec::new();
    let mut focal: Vec<f64> = Vec::new();
    for (given, found) in &pairs {
        let between = DQuat::from_mat3(&(given.axes.transpose() * rotation * found.axes)).normalize();
        turned.push(2.0 * between.w.abs().min(1.0).acos().to_degrees());
        let position = scale * (rotation * found.position) + move_by;
        moved.push(100.0 * (position - given.position).length() / extent);
        let long = |frame: &Frame| frame.lens.intrinsics.width.max(frame.lens.intrinsics.height) as f64;
        focal.push(found.lens.intrinsics.fx / long(found) / (given.lens.intrinsics.fx / long(given)));
    }
    println!(
        "registered {} of {}; rotation {:.2} median, {:.2} max degrees; position {:.2} median, {:.2} max %; focal {:+.2} %",
        pairs.len(),
        given.frames.len(),
        median(&mut turned),
        turned[turned.len() - 1],
        median(&mut moved),
        moved[moved.len() - 1],
        100.0 * (median(&mut focal) - 1.0)
    );
    Ok(())
}

/// Sorts, and returns the middle.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Rotation, scale and translation from the estimated world to the given one.
///
/// The rotation is the mean of the frames' own, so that cameras on a line have one, too; scale and translation follow by least squares.
fn align(pairs: &[(&Frame, &Frame)]) -> Option<(DMat3, f64, DVec3)> {
    let count = pairs.len() as f64;
    // The mean of rotations: the sum of their quaternions, all in one half of the sphere; outliers are left out in a second round.
    let own = |(given, found): &(&Frame, &Frame)| {
        DQuat::from_mat3(&(given.axes * found.axes.transpose())).normalize()
    };
    let mut mean = own(pairs.get(pairs.len() / 2)?);
    for _ in 0..20 {
        let mut sum = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        for pair in pairs {
            let own = own(pair);
            let own = if own.dot(mean) < 0.0 { -own } else { own };
            // Far ones weigh less.
            let weight = 1.0 / (0.01 + own.angle_between(mean));
            sum += own * weight;
        }
        mean = sum.normalize();
    }
    let rotation = DMat3::from_quat(mean);
    let a = pairs.iter().map(|(given, _)| given.position).sum::<DVec3>() / count;
    let b = pairs.iter().map(|(_, found)| rotation * found.position).sum::<DVec3>() / count;
    let (mut both, mut found_alone) = (0.0, 0.0);
    for (given, found) in pairs {
        let (given, found) = (given.position - a, rotation * found.position - b);
        both += given.dot(found);
        found_alone += found.length_squared();
    }
    let scale = both / found_alone;
    (scale > 0.0 && scale.is_finite()).then(|| (rotation, scale, a - b * scale))
}
