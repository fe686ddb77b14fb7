//! The host's inputs of the passes, and its use of the resulting sums.

use crate::{Profile, ShAxes};
use glam::{DMat3, DVec3};
use gs_scene::Camera;
use gs_shaders::{Frame, POSE_SUMS, TILE};

/// The uniform of a view of `n_gaussians`. There is room for 2³² - 1 pairs.
///
/// # Panics
/// If the profile evaluates spherical harmonics in other axes than the world's: no pass does.
#[must_use]
pub fn frame(camera: &Camera, profile: &Profile, background: [f32; 3], n_gaussians: usize) -> Frame {
    assert_eq!(profile.sh_axes, ShAxes::Standard, "axes of the spherical harmonics");
    let lens = camera.intrinsics();
    let row = |i: usize| {
        let rotation = camera.rotation().row(i);
        split([rotation.x, rotation.y, rotation.z, camera.translation()[i]])
    };
    let rows = [row(0), row(1), row(2)];
    let (position, position_low) = split(camera.position().to_array());
    let size = [lens.width, lens.height];
    let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
    let (high_focal, focal_low) = split(focal);
    let (high_centre, centre_low) = split(centre);
    // Slopes of the picture's borders, and 15 % of its size beyond them.
    let margin = |i: usize| 0.15 * size[i] as f64;
    Frame {
        pose: rows.map(|(high, _)| high),
        pose_low: rows.map(|(_, low)| low),
        position,
        n_gaussians: n_gaussians as u32,
        position_low,
        near: profile.near as f32,
        focal: high_focal,
        focal_low,
        centre: high_centre,
        centre_low,
        slope_min: [0, 1].map(|i| ((-centre[i] - margin(i)) / focal[i]) as f32),
        slope_max: [0, 1].map(|i| ((size[i] as f64 - centre[i] + margin(i)) / focal[i]) as f32),
        size: size.map(|pixels| pixels as u32),
        tiles: size.map(|pixels| (pixels as u32).div_ceil(TILE)),
        background,
        far: profile.far as f32,
        eps2d: profile.eps2d as f32,
        alpha_max: profile.alpha_max as f32,
        alpha_min: profile.alpha_min as f32,
        transmittance_min: profile.transmittance_min as f32,
        compensation_min: profile.compensation_min as f32,
        pair_capacity: u32::MAX,
        zero: 0,
        ellipsoid_sigma: 1.0,
    }
}

/// The nearest f32, and what they leave over.
pub(crate) fn split<const N: usize>(values: [f64; N]) -> ([f32; N], [f32; N]) {
    let high = values.map(|value| value as f32);
    (high, std::array::from_fn(|i| (values[i] - f64::from(high[i])) as f32))
}

/// The inverse of [`split`].
pub(crate) fn join<const N: usize>(high: [f32; N], low: [f32; N]) -> [f64; N] {
    std::array::from_fn(|i| f64::from(high[i]) + f64::from(low[i]))
}

/// The derivatives by the world-to-camera matrix [R | t], `[3, 4]` row-major, from the `[workgroups, 15]` sums of
/// `project_backward`: its twelve entries taken as independent and the camera centre as -Rᵀ t.
#[must_use]
pub fn pose_gradient(pose_sums: &[f32], camera: &Camera) -> [f64; 12] {
    let mut sums = [0.0; POSE_SUMS];
    for group in pose_sums.chunks_exact(POSE_SUMS) {
        for (sum, &value) in sums.iter_mut().zip(group) {
            *sum += f64::from(value);
        }
    }
    let by_row = |i: usize| DVec3::new(sums[3 * i], sums[3 * i + 1], sums[3 * i + 2]);
    let (by_translation, by_centre) = (by_row(3), by_row(4));
    let by_axes = DMat3::from_cols(by_row(0), by_row(1), by_row(2)).transpose();
    let (rotation, t) = (camera.rotation(), camera.translation());
    // [R | t] ← D [R | t] changes R as D does, less what it changes t.
    let by_rotation = (by_axes - outer(by_translation, t)) * rotation.inverse().transpose();
    let mut out = [0.0; 12];
    for i in 0..3 {
        // Entry j of the centre is -Σᵢ Rᵢⱼ tᵢ.
        let row = by_rotation.row(i) - t[i] * by_centre;
        out[4 * i..][..3].copy_from_slice(&row.to_array());
        out[4 * i + 3] = by_translation[i] - rotation.row(i).dot(by_centre);
    }
    out
}

/// a bᵀ.
pub(crate) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
