//! Measured depth against poses: warped from view to view, and against triangulated matches.

use super::epipolar::{Posed, triangulate};
use super::readings::{PairMatches, median};
use super::report::DepthSummary;
use super::scan::{Scan, SmallDepth};
use glam::DVec3;
use rayon::prelude::*;
use view_data::Lens;

/// Depths agree if they differ by at most this share.
const CONSISTENT: f64 = 0.02;
/// Differences beyond this share are something else in front, not an error of the depth.
const OCCLUDED: f64 = 0.25;
/// Every so many pixels of the reduced map are warped, along both axes.
const STRIDE: usize = 3;
/// Angle between the rays of a match that is triangulated well enough to compare, radians: one degree.
const MIN_ANGLE: f64 = 0.0175;
/// Matches that a ratio is taken of, at least.
const MIN_MATCHES: usize = 30;

/// A frame with measured depth.
struct Measured<'a> {
    posed: &'a Posed,
    lens: &'a Lens,
    map: &'a SmallDepth,
}

/// Compares the depth of all pairs whose frames both have some; `None` if none has.
pub(crate) fn check_depth(
    scans: &[Option<&Scan>],
    posed: &[Option<Posed>],
    pairs: &[PairMatches],
) -> Option<DepthSummary> {
    let measured = |i: usize| {
        let scan = scans[i]?;
        let map = scan.depth.as_ref()?.as_ref().ok()?.map.as_ref()?;
        Some(Measured { posed: posed[i].as_ref()?, lens: &scan.lens, map })
    };
    // Pair by pair in order: the same sums on any number of threads.
    let warped: Vec<Option<Vec<f64>>> = pairs
        .par_iter()
        .map(|pair| {
            let (first, second) = (measured(pair.first)?, measured(pair.second)?);
            let mut differences = warp(&first, &second);
            differences.extend(warp(&second, &first));
            Some(differences)
        })
        .collect();
    let with_depth = warped.iter().flatten().count();
    let differences: Vec<f64> = warped.into_iter().flatten().flatten().collect();
    let ratios: Vec<Ratio> = pairs
        .iter()
        .filter_map(|pair| {
            let first = measured(pair.first)?;
            let second = posed[pair.second].as_ref()?;
            Some(ratios(&first, second, pair))
        })
        .flatten()
        .collect();
    if with_depth == 0 && ratios.is_empty() {
        return None;
    }
    let share = |count: usize, total: usize| (total > 0).then(|| count as f64 / total as f64);
    let consistent = differences.iter().filter(|d| **d <= CONSISTENT).count();
    let unoccluded: Vec<f64> = differences.iter().copied().filter(|d| *d <= OCCLUDED).collect();
    let mut summary = DepthSummary {
        pairs: with_depth,
        consistent: share(consistent, differences.len()),
        median_difference: median(unoccluded),
        matches: ratios.len(),
        ..DepthSummary::default()
    };
    if ratios.len() >= MIN_MATCHES {
        let along_z: Vec<f64> = ratios.iter().map(|ratio| ratio.z).collect();
        let along_ray: Vec<f64> = ratios.iter().map(|ratio| ratio.z / ratio.ray).collect();
        summary.ratio = median(along_z.clone());
        summary.spread_z = spread(along_z);
        summary.spread_ray = spread(along_ray);
    }
    Some(summary)
}

/// Median relative deviation from the median.
fn spread(values: Vec<f64>) -> Option<f64> {
    let middle = median(values.clone())?;
    median(values.into_iter().map(|value| (value / middle - 1.0).abs()).collect())
}

/// Relative differences between the depth of one view, seen from the other, and what the other measured.
fn warp(from: &Measured, to: &Measured) -> Vec<f64> {
    let mut differences = Vec::new();
    let to_camera = to.posed.axes.transpose();
    for y in (0..from.map.height).step_by(STRIDE) {
        for x in (0..from.map.width).step_by(STRIDE) {
            let depth = f64::from(from.map.data[y * from.map.width + x]);
            if depth <= 0.0 {
                continue;
            }
            let pixel = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * from.map.step;
            let Some(direction) = from.lens.undistort(pixel) else { continue };
            let world = from.posed.position + from.posed.axes * (direction.extend(1.0) * depth);
            let seen: DVec3 = to_camera * (world - to.posed.position);
            if seen.z <= 0.0 {
                continue;
            }
            let pixel = to.lens.distort_one_to_one(seen.truncate() / seen.z);
            let Some(found) = pixel.and_then(|pixel| to.map.at(pixel)) else { continue };
            differences.push((found / seen.z - 1.0).abs());
        }
    }
    differences
}

/// Measured over triangulated depth of a match.
struct Ratio {
    z: f64,
    /// Length of the ray of unit z-depth.
    ray: f64,
}

fn ratios(first: &Measured, second: &Posed, pair: &PairMatches) -> Vec<Ratio> {
    let ratio = |found: &super::matching::Match| {
        let point = triangulate(first.posed, second, found)?;
        if point.angle < MIN_ANGLE || point.first <= 0.0 || point.second <= 0.0 {
            return None;
        }
        // A match lies where a pinhole would see it; the map, where the lens did.
        let ray = first.posed.intrinsics.ray(found.first);
        let measured = first.map.at(first.lens.distort_one_to_one(ray.truncate())?)?;
        Some(Ratio { z: measured / point.first, ray: ray.length() })
    };
    pair.matches.iter().filter_map(ratio).collect()
}
