//! Whether a camera that turns in one place explains the photographs.
//!
//! An engine that does not know focal length and distortion can make up a movement from them: the more so the less the camera moved.

use crate::Photograph;
use crate::engine::Solution;
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use view_data::{Observation, ScenePoint};

/// Matches that a pair of photographs needs.
const MATCHES: u32 = 20;
/// Pairs that are looked at, evenly chosen.
const PAIRS: usize = 60;
/// Matches of a pair that are looked at, evenly chosen.
const OF_PAIR: usize = 200;
/// Focal lengths that are tried, over that of the engine.
const FOCAL: [f64; 11] = [0.6, 0.66, 0.72, 0.79, 0.87, 0.95, 1.04, 1.14, 1.25, 1.37, 1.5];
/// Radial distortions that are tried.
const RADIAL: [f64; 9] = [-0.3, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.3];
/// Share of the matches that are to be explained.
const SHARE: f64 = 0.9;

/// Matches of two photographs: positions from the middle of each, long sides of the picture; and the focal lengths of the engine in that unit.
struct Pair {
    seen: Vec<[DVec2; 2]>,
    focal: [f64; 2],
}

/// How far from its place, in long sides of the picture, the share [`SHARE`] of the matches is at most if cameras only turn: with one factor
/// of the focal length and one distortion, those that fit best. None if there are no pairs with matches enough.
pub(crate) fn turned(solution: &Solution, photographs: &[Photograph]) -> Option<f64> {
    let pairs = pairs(solution, photographs);
    let trials: Vec<(f64, f64)> = FOCAL.iter().flat_map(|&f| RADIAL.map(|k| (f, k))).collect();
    let trial = |&(factor, radial): &(f64, f64)| {
        let mut distances: Vec<f64> = pairs
            .iter()
            .flat_map(|pair| pair.distances(factor, radial))
            .filter(|far| far.is_finite())
            .collect();
        let rank = (distances.len() as f64 * SHARE) as usize;
        (rank < distances.len()).then(|| *distances.select_nth_unstable_by(rank, f64::total_cmp).1)
    };
    trials.par_iter().filter_map(trial).min_by(f64::total_cmp)
}

fn pairs(solution: &Solution, photographs: &[Photograph]) -> Vec<Pair> {
    // Counted first: long tracks are in very many pairs.
    let count = photographs.len();
    let mut matches = vec![0u32; count * count];
    for [a, b] in solution.points.iter().flat_map(pairs_of) {
        matches[a.frame * count + b.frame] += 1;
    }
    let enough: Vec<usize> = (0..count * count).filter(|&index| matches[index] >= MATCHES).collect();
    let mut seen: BTreeMap<[usize; 2], Vec<[DVec2; 2]>> =
        evenly(&enough, PAIRS).map(|index| ([index / count, index % count], Vec::new())).collect();
    let place = |frame: usize, pixel: DVec2| {
        let Photograph { width, height, .. } = photographs[frame];
        (pixel - DVec2::new(width as f64, height as f64) / 2.0) / width.max(height) as f64
    };
    for [a, b] in solution.points.iter().flat_map(pairs_of) {
        if let Some(of_pair) = seen.get_mut(&[a.frame, b.frame]) {
            of_pair.push([place(a.frame, a.pixel), place(b.frame, b.pixel)]);
        }
    }
    let focal = |frame: usize| {
        let photograph = &photographs[frame];
        solution.lenses[photograph.camera].intrinsics.fx / photograph.width.max(photograph.height) as f64
    };
    let pair = |(frames, seen): ([usize; 2], Vec<_>)| Pair {
        seen: evenly(&seen, OF_PAIR).copied().collect(),
        focal: frames.map(focal),
    };
    seen.into_iter().map(pair).collect()
}

/// The pairs of photographs that see a point, the earlier one first.
fn pairs_of(point: &ScenePoint) -> impl Iterator<Item = [&Observation; 2]> {
    let seen = &point.observations;
    let pairs = seen.iter().enumerate().flat_map(|(i, a)| seen[i + 1..].iter().map(move |b| [a, b]));
    pairs.filter(|[a, b]| a.frame != b.frame).map(|[a, b]| if a.frame < b.frame { [a, b] } else { [b, a] })
}

/// At most `count` of all, evenly spaced.
fn evenly<T>(all: &[T], count: usize) -> impl Iterator<Item = &T> {
    let count = count.min(all.len());
    (0..count).map(move |i| &all[i * all.len() / count])
}

impl Pair {
    /// Distances of the matches from where the best rotation takes them.
    fn distances(&self, factor: f64, radial: f64) -> impl Iterator<Item = f64> {
        let focal = self.focal.map(|focal| focal * factor);
        let ray = |position: DVec2, focal: f64| {
            let direction = position / focal;
            (direction * (1.0 + radial * direction.length_squared())).extend(1.0).normalize()
        };
        let rays: Vec<[DVec3; 2]> =
            self.seen.iter().map(|[a, b]| [ray(*a, focal[0]), ray(*b, focal[1])]).collect();
        let rotation = best_rotation(&rays);
        rays.into_iter().map(move |[a, b]| (rotation * a - b).length() * focal[1])
    }
}

/// The rotation that brings the first of each pair of rays nearest to the second, by the quaternion that is the eigenvector of Horn's matrix
/// with the largest eigenvalue.
fn best_rotation(rays: &[[DVec3; 2]]) -> DMat3 {
    let mut sum = DMat3::ZERO;
    for [a, b] in rays {
        sum += DMat3::from_cols(*a * b.x, *a * b.y, *a * b.z);
    }
    let s = |i: usize, j: usize| sum.col(j)[i];
    let rows = [
        [s(0, 0) + s(1, 1) + s(2, 2), s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0)],
        [s(1, 2) - s(2, 1), s(0, 0) - s(1, 1) - s(2, 2), s(0, 1) + s(1, 0), s(2, 0) + s(0, 2)],
        [s(2, 0) - s(0, 2), s(0, 1) + s(1, 0), s(1, 1) - s(0, 0) - s(2, 2), s(1, 2) + s(2, 1)],
        [s(0, 1) - s(1, 0), s(2, 0) + s(0, 2), s(1, 2) + s(2, 1), s(2, 2) - s(0, 0) - s(1, 1)],
    ];
    // Shifted, all eigenvalues are positive, and squaring a matrix again and again leaves the largest one.
    let shift = 2.0 * rays.len() as f64;
    let mut matrix = rows;
    (0..4).for_each(|i| matrix[i][i] += shift);
    for _ in 0..24 {
        let largest =
            matrix.as_flattened().iter().fold(0.0, |largest: f64, number| largest.max(number.abs()));
        let before = matrix.map(|row| row.map(|number| number / largest));
        for (i, row) in matrix.iter_mut().enumerate() {
            for (j, number) in row.iter_mut().enumerate() {
                *number = (0..4).map(|k| before[i][k] * before[k][j]).sum();
            }
        }
    }
    // Any column; the longest is farthest from 0.
    let length = |row: &[f64; 4]| row.iter().map(|number| number * number).sum::<f64>();
    let [w, x, y, z] = matrix.into_iter().max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or_default();
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Pose;
    use crate::verdict::TURNED;
    use gs_scene::{Distortion, Intrinsics, Lens};

    #[test]
    fn rotations_are_found_again() {
        let rotation = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, -0.9, 2.2);
        let ray = |i: i32| DVec3::new(f64::from(i % 5) - 2.0, f64::from(i % 7) - 3.0, 4.0).normalize();
        let rays: Vec<[DVec3; 2]> = (0..40).map(|i| [ray(i), rotation * ray(i)]).collect();
        assert!(best_rotation(&rays).abs_diff_eq(rotation, 1e-9));
        let half_turn = DMat3::from_rotation_x(std::f64::consts::PI);
        let rays: Vec<[DVec3; 2]> = (0..40).map(|i| [ray(i), half_turn * ray(i)]).collect();
        assert!(best_rotation(&rays).abs_diff_eq(half_turn, 1e-9));
    }

    /// A camera that turns, and moves by `step` from photograph to photograph, before points 2 to 6 away. Its focal length is 0.8; the engine is
    /// said to have found 1.0.
    fn solution(step: f64) -> (Solution, Vec<Photograph>) {
        let (width, height) = (480, 360);
        let photographs = (0..5).map(|i| Photograph::of_size(&i.to_string(), [width, height])).collect();
        let poses: Vec<Pose> = (0..5)
            .map(|i| Pose {
                axes: DMat3::from_rotation_y(0.08 * f64::from(i)),
                position: DVec3::X * step * f64::from(i),
            })
            .collect();
        let mut points = Vec::new();
        for i in 0..300 {
            let z = 2.0 + f64::from(i % 9) / 2.0;
            let position =
                DVec3::new(f64::from(i % 17) / 8.0 - 1.0, f64::from(i % 13) / 6.0 - 1.0, 1.0) * z * 0.5;
            let seen = |(frame, pose): (usize, &Pose)| {
                let camera_point = pose.axes.transpose() * (position - pose.position);
                let pixel = camera_point.truncate() / camera_point.z * 0.8 * 480.0 + DVec2::new(240.0, 180.0);
                Observation { frame, pixel }
            };
            let observations = poses.iter().enumerate().map(seen).collect();
            points.push(ScenePoint { position, colour: None, error: None, observations });
        }
        let intrinsics = Intrinsics { fx: 480.0, fy: 480.0, cx: 240.0, cy: 180.0, width, height };
        let lens = Lens { intrinsics, model: Distortion::default().into() };
        let poses = poses.into_iter().map(Some).collect();
        (Solution { lenses: vec![lens], poses, reasons: vec![None; 5], points }, photographs)
    }

    #[test]
    fn a_camera_that_turns_is_told_from_one_that_moves() {
        let pixels = |step| {
            let (solution, photographs) = solution(step);
            480.0 * turned(&solution, &photographs).unwrap()
        };
        assert!(pixels(0.0) < 0.5 * TURNED, "{}", pixels(0.0));
        assert!(pixels(0.1) > 2.0 * TURNED, "{}", pixels(0.1));
        let (mut empty, photographs) = solution(0.1);
        empty.points.clear();
        assert_eq!(turned(&empty, &photographs), None);
    }
}
