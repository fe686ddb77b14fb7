//! Which views a view is matched with.

use crate::range::Planes;
use glam::DVec2;
use gs_scene::Camera;

/// Grid of test points per axis.
const GRID: usize = 8;
/// Triangulation angle, degrees, up to which more is better.
const FULL_ANGLE: f64 = 8.0;
/// Standard deviation, degrees, of the fall of the weight beyond it: perspective distortion makes windows differ.
const ANGLE_WIDTH: f64 = 20.0;

/// What a triangulation angle (degrees) is worth for matching, 0..1.
fn angle_weight(degrees: f64) -> f64 {
    if degrees < FULL_ANGLE {
        degrees / FULL_ANGLE
    } else {
        (-0.5 * ((degrees - FULL_ANGLE) / ANGLE_WIDTH).powi(2)).exp()
    }
}

/// How well `source` serves to find the depth of `reference`, 0..1: the mean, over a grid of pixels at three depths, of
/// being in the picture times the worth of the angle there.
fn score(reference: &Camera, source: &Camera, planes: &Planes) -> f64 {
    let size = DVec2::new(reference.width() as f64, reference.height() as f64);
    let mut sum = 0.0;
    for part in [0.25, 0.5, 0.75] {
        let depth = 1.0 / planes.inverse_depth_at(part);
        for i in 0..GRID * GRID {
            let cell = DVec2::new((i % GRID) as f64 + 0.5, (i / GRID) as f64 + 0.5) / GRID as f64;
            let point = reference.unproject(cell * size, depth);
            if source.project(point).is_some_and(|pixel| source.contains(pixel)) {
                let rays = (point - reference.position(), point - source.position());
                sum += angle_weight(rays.0.angle_between(rays.1).to_degrees());
            }
        }
    }
    sum / (3 * GRID * GRID) as f64
}

/// For each view the indices of up to `limit` others to match it with, best first; ties go to the lower index. Views
/// without anything in common are never chosen.
pub(crate) fn choose(cameras: &[Camera], planes: &Planes, limit: usize) -> Vec<Vec<usize>> {
    let choose_for = |reference: usize| {
        let mut scored: Vec<(f64, usize)> = (0..cameras.len())
            .filter(|&source| source != reference)
            .map(|source| (score(&cameras[reference], &cameras[source], planes), source))
            .filter(|&(score, _)| score > 0.0)
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        scored.into_iter().take(limit).map(|(_, source)| source).collect()
    };
    (0..cameras.len()).map(choose_for).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_scene::Intrinsics;

    #[test]
    fn prefers_a_useful_angle_to_the_nearest_camera_and_drops_the_blind() {
        let lens = Intrinsics { fx: 300.0, fy: 300.0, cx: 160.0, cy: 120.0, width: 320, height: 240 };
        let camera = |degrees: f64| {
            let angle = degrees.to_radians();
            let position = DVec3::new(3.0 * angle.sin(), 0.0, -3.0 * angle.cos());
            Camera::looking_at(lens, position, DVec3::ZERO, DVec3::NEG_Y).unwrap()
        };
        let away =
            Camera::looking_at(lens, DVec3::new(0.0, 0.0, -3.0), DVec3::new(0.0, 0.0, -9.0), DVec3::NEG_Y);
        let planes = Planes::new(2.0, 5.0, 64).unwrap();
        let cameras = [camera(0.0), camera(0.5), camera(9.0), camera(70.0), away.unwrap()];
        assert_eq!(choose(&cameras, &planes, 4)[0], [2, 1, 3]);
        assert!(choose(&cameras, &planes, 4)[4].is_empty());
    }
}
