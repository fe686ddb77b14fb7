//! Camera paths for videos.

use crate::{Error, Result};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Gaussians, Intrinsics};

/// Radii of an orbit as a share of the distance to what it looks at, at least and at most.
const RADII: [f64; 2] = [0.05, 0.35];

/// Gaussians that [`fullest`] looks at.
const SAMPLE: usize = 4096;

/// Place of the camera in whose picture the centres of most Gaussians lie, of a sample; the first of equals, 0 where there is none.
#[must_use]
pub fn fullest(cameras: &[Camera], gaussians: &Gaussians) -> usize {
    let step = gaussians.len().div_ceil(SAMPLE).max(1);
    let seen = |camera: &Camera| {
        let rows = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).step_by(step);
        let means = rows.map(|row| DVec3::new(row[0].into(), row[1].into(), row[2].into()));
        means.filter(|&mean| camera.project(mean).is_some_and(|pixel| camera.contains(pixel))).count()
    };
    let counts: Vec<usize> = cameras.iter().map(seen).collect();
    // The last of equals, from behind.
    (0..counts.len()).rev().max_by_key(|&i| counts[i]).unwrap_or(0)
}

/// `frames` cameras along a list of cameras, in its order: positions on a Catmull-Rom spline, rotations by slerp, each stretch between
/// two cameras for the same time. Lens and size are those of the first.
///
/// # Errors
/// If there is no camera.
pub fn along(cameras: &[Camera], frames: usize) -> Result<Vec<Camera>> {
    let first = cameras.first().ok_or(Error::NoCamera)?;
    let last = cameras.len() - 1;
    let position = |i: usize| cameras[i.min(last)].position();
    (0..frames)
        .map(|frame| {
            let share = if frames > 1 { frame as f64 / (frames - 1) as f64 } else { 0.0 };
            let progress = share * last as f64;
            let i = (progress as usize).min(last);
            let t = progress - i as f64;
            let [before, from, to, after] =
                [position(i.saturating_sub(1)), position(i), position(i + 1), position(i + 2)];
            let place = 0.5
                * (2.0 * from
                    + (to - before) * t
                    + (2.0 * before - 5.0 * from + 4.0 * to - after) * t * t
                    + (3.0 * from - before - 3.0 * to + after) * t * t * t);
            let turn = |i: usize| DQuat::from_mat3(&cameras[i.min(last)].rotation());
            let axes = DMat3::from_quat(turn(i).slerp(turn(i + 1), t)).transpose();
            Ok(Camera::from_camera_to_world(*first.intrinsics(), axes, place)?)
        })
        .collect()
}

/// `frames` cameras on a closed ellipse about the middle camera of a list, all of which look at the point at the scene's median
/// depth before it. The ellipse is as wide and as high as the cameras are spread, within limits that keep the scene in view.
///
/// # Errors
/// If there is no camera.
pub fn around(cameras: &[Camera], gaussians: &Gaussians, frames: usize) -> Result<Vec<Camera>> {
    let middle = cameras.get(cameras.len() / 2).ok_or(Error::NoCamera)?;
    let rows = [0, 1].map(|row| middle.rotation().row(row));
    let mut depths: Vec<f64> = gaussians
        .geometry()
        .chunks_exact(Gaussians::GEOMETRY)
        .map(|row| middle.to_camera(DVec3::new(row[0].into(), row[1].into(), row[2].into())).z)
        .filter(|depth| depth.is_finite() && *depth > 0.0)
        .collect();
    let half = depths.len() / 2;
    let distance =
        if depths.is_empty() { 1.0 } else { *depths.select_nth_unstable_by(half, f64::total_cmp).1 };
    let target = middle.position() + distance * middle.forward();
    let radii = rows.map(|axis| {
        let reach = cameras.iter().map(|camera| (camera.position() - middle.position()).dot(axis).abs());
        reach.fold(0.0, f64::max).clamp(RADII[0] * distance, RADII[1] * distance)
    });
    (0..frames)
        .map(|frame| {
            let (sin, cos) = (std::f64::consts::TAU * frame as f64 / frames as f64).sin_cos();
            let place = middle.position() + radii[0] * cos * rows[0] + radii[1] * sin * rows[1];
            Ok(Camera::looking_at(*middle.intrinsics(), place, target, -rows[1])?)
        })
        .collect()
}

/// A camera before a scene that comes without one: outside, level, y down, so far away that four fifths of the scene's extent
/// fill the picture.
///
/// # Errors
/// If the scene lies where no camera can be.
pub fn overview(gaussians: &Gaussians) -> Result<Camera> {
    let extents = [0, 1, 2].map(|axis| {
        let mut values: Vec<f32> = gaussians
            .geometry()
            .chunks_exact(Gaussians::GEOMETRY)
            .map(|row| row[axis])
            .filter(|value| value.is_finite())
            .collect();
        values.sort_unstable_by(f32::total_cmp);
        let quantile = |share: f64| {
            let place = (values.len().saturating_sub(1) as f64 * share).round() as usize;
            f64::from(values.get(place).copied().unwrap_or(0.0))
        };
        (quantile(0.5), quantile(0.9) - quantile(0.1))
    });
    let reach = extents.iter().map(|extent| extent.1).fold(0.0, f64::max);
    let reach = if reach > 0.0 { reach } else { 1.0 };
    let centre = DVec3::from_array(extents.map(|extent| extent.0));
    let lens = Intrinsics { fx: 800.0, fy: 800.0, cx: 480.0, cy: 360.0, width: 960, height: 720 };
    Ok(Camera::new(lens, DMat3::IDENTITY, DVec3::Z * 1.6 * reach - centre)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> Vec<Camera> {
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 10.0, cy: 8.0, width: 20, height: 16 };
        [(-1.0, 0.2), (0.0, 0.0), (1.5, -0.1)]
            .map(|(x, y)| {
                Camera::looking_at(lens, DVec3::new(x, y, -4.0), DVec3::ZERO, DVec3::NEG_Y).unwrap()
            })
            .to_vec()
    }

    #[test]
    fn the_fullest_camera_sees_most_of_the_scene() {
        let lens = *cameras()[0].intrinsics();
        let looking = |target| Camera::looking_at(lens, DVec3::ZERO, target, DVec3::NEG_Y).unwrap();
        let [away, ahead, beside] = [DVec3::NEG_Z, DVec3::Z, DVec3::X].map(looking);
        let mut scene = Gaussians::empty(0).unwrap();
        assert_eq!(fullest(&[away, ahead], &scene), 0, "of equals the first");
        assert_eq!(fullest(&[], &scene), 0);
        for mean in [[0.0, 0.0, 5.0], [0.1, 0.0, 4.0], [5.0, 0.0, 0.0], [f32::NAN; 3]] {
            scene.push(mean, [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
        }
        assert_eq!(fullest(&[away, beside, ahead, ahead], &scene), 2);
        assert_eq!(fullest(&[away, beside], &scene), 1);
    }

    #[test]
    fn a_path_passes_through_its_cameras() {
        let cameras = cameras();
        let path = along(&cameras, 5).unwrap();
        for (frame, camera) in [(0, &cameras[0]), (2, &cameras[1]), (4, &cameras[2])] {
            assert!((path[frame].position() - camera.position()).length() < 1e-12);
            assert!((path[frame].forward() - camera.forward()).length() < 1e-9);
        }
        assert_eq!(along(&cameras[..1], 3).unwrap().len(), 3);
        assert!(along(&cameras, 0).unwrap().is_empty());
        assert!(matches!(along(&[], 3), Err(Error::NoCamera)));
    }

    #[test]
    fn an_overview_shows_the_scene() {
        let mut scene = Gaussians::empty(0).unwrap();
        assert!(overview(&scene).is_ok());
        for x in [4.0, 5.0, f32::NAN, 6.0] {
            scene.push([x, 2.0, 30.0], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
        }
        let camera = overview(&scene).unwrap();
        for x in [4.0, 6.0] {
            assert!(camera.project(DVec3::new(x, 2.0, 30.0)).is_some_and(|pixel| camera.contains(pixel)));
        }
    }

    #[test]
    fn an_orbit_looks_at_one_point_from_a_closed_curve() {
        let mut scene = Gaussians::empty(0).unwrap();
        scene.push([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
        let path = around(&cameras(), &scene, 8).unwrap();
        for (camera, opposite) in path.iter().zip(&path[4..]) {
            let seen = camera.to_camera(DVec3::ZERO);
            assert!(seen.x.abs() < 1e-9 && seen.y.abs() < 1e-9 && seen.z > 3.0);
            assert!(
                ((camera.position() + opposite.position()) / 2.0 - DVec3::new(0.0, 0.0, -4.0)).length()
                    < 1e-9
            );
        }
        assert_eq!(around(&cameras(), &Gaussians::empty(0).unwrap(), 4).unwrap().len(), 4);
        assert!(matches!(around(&[], &scene, 3), Err(Error::NoCamera)));
    }
}
