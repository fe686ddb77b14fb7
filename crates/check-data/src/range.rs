//! The distance of the scene, from the best available source.

use super::epipolar::{Posed, triangulate};
use super::readings::{PairMatches, quantile};
use super::report::{RangeSource, RangeSummary};
use super::scan::Scan;
use glam::DVec3;
use gs_scene::Camera;
use view_data::{Dataset, SceneDepth, ScenePoint, estimate_scene_depth};

/// Depths that percentiles are taken of, at least.
const MIN_DEPTHS: usize = 50;
/// Angle between the rays of a match that is triangulated, radians: one degree.
const MIN_ANGLE: f64 = 0.0175;
/// Points whose depths are looked at in every frame, at most.
const MAX_POINTS: usize = 20_000;
/// The suggestion goes so much beyond the percentiles 0.5 and 99.5: what matters may lie a little outside.
const MARGIN: f64 = 1.1;

/// Depths of what the data set knows, before anything is guessed.
pub(crate) struct Known<'a> {
    pub(crate) dataset: &'a Dataset,
    pub(crate) cameras: &'a [Camera],
    pub(crate) points: &'a [ScenePoint],
    pub(crate) scans: &'a [Option<&'a Scan>],
    pub(crate) posed: &'a [Option<Posed>],
    pub(crate) pairs: &'a [PairMatches],
    /// Whether the poses as read fit the matches.
    pub(crate) poses_fit: bool,
    /// Whether measured depth is in the units of the poses, as far as is known.
    pub(crate) depth_fits: bool,
}

/// The range by the first source that has enough: measured depth, points, triangulated matches if the poses
/// fit, the file's statement, the poses alone.
pub(crate) fn find_range(known: &Known) -> Option<RangeSummary> {
    let from = |source, depths: Vec<f64>| {
        (depths.len() >= MIN_DEPTHS).then(|| percentiles(depths).map(|p| summary(source, p))).flatten()
    };
    let stated = || {
        let p = known.dataset.depth_percentiles?;
        Some(summary(RangeSource::Stated, [p.p0_5, p.p2, p.p50, p.p98, p.p99_5]))
    };
    let guessed = || {
        let SceneDepth { near, median, far } = estimate_scene_depth(known.cameras)?;
        Some(summary(RangeSource::Poses, [near, near, median, far, far]))
    };
    let measured = known.depth_fits.then(|| from(RangeSource::Measured, measured(known))).flatten();
    measured
        .or_else(|| from(RangeSource::Points, of_points(known)))
        .or_else(|| known.poses_fit.then(|| from(RangeSource::Matches, triangulated(known))).flatten())
        .or_else(stated)
        .or_else(guessed)
}

fn summary(source: RangeSource, percentiles: [f64; 5]) -> RangeSummary {
    let [nearest, .., farthest] = percentiles;
    // A guess has its margin already.
    let margin = if source == RangeSource::Poses { 1.0 } else { MARGIN };
    let near_far = [two_digits(nearest / margin, false), two_digits(farthest * margin, true)];
    RangeSummary { source, percentiles, near_far }
}

/// Two digits say what such a number is worth; near is rounded down, far up.
fn two_digits(value: f64, up: bool) -> f64 {
    let unit = 10f64.powf(value.log10().floor() - 1.0);
    let digits = value / unit;
    // Powers of ten above 1 are exact, those below are not: divide instead of multiplying.
    let digits = if up { (digits - 1e-9).ceil() } else { (digits + 1e-9).floor() };
    let rounded = if unit < 1.0 { digits / unit.recip().round() } else { digits * unit };
    if rounded > 0.0 && rounded.is_finite() { rounded } else { value }
}

fn percentiles(mut depths: Vec<f64>) -> Option<[f64; 5]> {
    depths.sort_by(f64::total_cmp);
    let [a, b, c, d, e] = [0.005, 0.02, 0.5, 0.98, 0.995].map(|share| quantile(&depths, share));
    Some([a?, b?, c?, d?, e?])
}

fn measured(known: &Known) -> Vec<f64> {
    let files = known.scans.iter().flatten().filter_map(|scan| scan.depth.as_ref()?.as_ref().ok());
    files.flat_map(|depth| depth.samples.iter().map(|&depth| f64::from(depth))).collect()
}

/// Depths of points in the frames that see them; where the file does not say who does, in those whose picture
/// they fall into.
fn of_points(known: &Known) -> Vec<f64> {
    let stride = known.points.len().div_ceil(MAX_POINTS).max(1);
    let mut depths = Vec::new();
    for point in known.points.iter().step_by(stride) {
        if point.observations.is_empty() {
            // One frame in eight: each point has plenty.
            let frames = known.cameras.iter().step_by((known.cameras.len() / 8).max(1));
            let inside = frames.filter(|c| c.project(point.position).is_some_and(|pixel| c.contains(pixel)));
            depths.extend(inside.map(|camera| camera.to_camera(point.position).z));
        }
        for seen in &point.observations {
            let Some(camera) = known.cameras.get(seen.frame) else { continue };
            depths.push(camera.to_camera(point.position).z);
        }
    }
    depths.retain(|depth| *depth > 0.0 && depth.is_finite());
    depths
}

fn triangulated(known: &Known) -> Vec<f64> {
    points_of_matches(known.posed, known.pairs)
        .into_iter()
        .flat_map(|point| [point.first, point.second])
        .collect()
}

/// A match as a point of the world, with its depths in the two cameras.
pub(crate) struct MatchPoint {
    pub(crate) world: DVec3,
    first: f64,
    second: f64,
}

/// The matches whose rays meet at a usable angle in front of both cameras.
pub(crate) fn points_of_matches(posed: &[Option<Posed>], pairs: &[PairMatches]) -> Vec<MatchPoint> {
    let mut points = Vec::new();
    for pair in pairs {
        let (Some(first), Some(second)) = (&posed[pair.first], &posed[pair.second]) else { continue };
        for found in &pair.matches {
            let Some(point) = triangulate(first, second, found) else { continue };
            if point.angle >= MIN_ANGLE && point.first > 0.0 && point.second > 0.0 {
                let ray = first.axes * first.intrinsics.ray(found.first);
                let world = first.position + ray * point.first;
                points.push(MatchPoint { world, first: point.first, second: point.second });
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn suggestions_have_two_digits_and_hold_the_range(near in 1e-6f64..1e6, more in 1.01f64..1e4) {
            let far = near * more;
            let [low, high] = summary(RangeSource::Points, [near, near, near, far, far]).near_far;
            prop_assert!(low < near && low > near * 0.8, "{} {}", low, near);
            prop_assert!(high > far && high < far * 1.25, "{} {}", high, far);
            for value in [low, high] {
                let digits = format!("{value:e}");
                prop_assert!(digits.split('e').next().unwrap().len() <= 3, "{}", digits);
            }
        }
    }

    #[test]
    fn percentiles_are_ranks() {
        let found = percentiles((0..1001).map(f64::from).collect()).unwrap();
        assert_eq!(found, [5.0, 20.0, 500.0, 980.0, 995.0]);
        assert_eq!(percentiles(Vec::new()), None);
        assert_eq!(summary(RangeSource::Poses, [1.2, 1.2, 3.0, 6.0, 6.0]).near_far, [1.2, 6.0]);
    }
}
