//! What a host hands to the passes: the uniform of a view, geometry relative to an origin, and what it makes of the sums
//! that come back.

use crate::{Profile, ShAxes};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians, MEAN};
use gs_shaders::{Frame, POSE_SUMS, TILE};

/// The uniform of a view of `n_gaussians`, means relative to `origin` (world, scene units). There is room for 2³² - 1 pairs.
///
/// # Panics
/// If the profile evaluates spherical harmonics in other axes than the world's: no pass does.
#[must_use]
pub fn frame(
    camera: &Camera,
    profile: &Profile,
    background: [f32; 3],
    origin: DVec3,
    n_gaussians: usize,
) -> Frame {
    assert_eq!(profile.sh_axes, ShAxes::Standard, "axes of the spherical harmonics");
    let lens = camera.intrinsics();
    let translation = camera.to_camera(origin);
    let row = |i: usize| {
        let rotation = camera.rotation().row(i);
        [rotation.x as f32, rotation.y as f32, rotation.z as f32, translation[i] as f32]
    };
    let size = [lens.width, lens.height];
    let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
    // Slopes of the picture's borders, and 15 % of its size beyond them.
    let margin = |i: usize| 0.15 * size[i] as f64;
    Frame {
        pose: [row(0), row(1), row(2)],
        position: (camera.position() - origin).as_vec3().to_array(),
        n_gaussians: n_gaussians as u32,
        focal: focal.map(|f| f as f32),
        centre: centre.map(|c| c as f32),
        slope_min: [0, 1].map(|i| ((-centre[i] - margin(i)) / focal[i]) as f32),
        slope_max: [0, 1].map(|i| ((size[i] as f64 - centre[i] + margin(i)) / focal[i]) as f32),
        size: size.map(|pixels| pixels as u32),
        tiles: size.map(|pixels| (pixels as u32).div_ceil(TILE)),
        background,
        near: profile.near as f32,
        far: profile.far as f32,
        eps2d: profile.eps2d as f32,
        alpha_max: profile.alpha_max as f32,
        alpha_min: profile.alpha_min as f32,
        transmittance_min: profile.transmittance_min as f32,
        compensation_min: profile.compensation_min as f32,
        pair_capacity: u32::MAX,
        padding: 0,
    }
}

/// The geometry buffer `[N, 11]` of a scene, means relative to `origin` (world, scene units).
#[must_use]
pub fn relative_geometry(gaussians: &Gaussians, origin: DVec3) -> Vec<f32> {
    let mut geometry = gaussians.geometry().to_vec();
    for row in geometry.chunks_exact_mut(Gaussians::GEOMETRY) {
        for (mean, origin) in row[MEAN].iter_mut().zip(origin.to_array()) {
            *mean = (f64::from(*mean) - origin) as f32;
        }
    }
    geometry
}

/// The derivatives by the world-to-camera matrix [R | t], `[3, 4]` row-major, from the `[workgroups, 15]` sums of
/// `project_backward`: its twelve entries taken as independent and the camera centre as -Rᵀ t.
#[must_use]
pub fn pose_gradient(pose_sums: &[f32], camera: &Camera, origin: DVec3) -> [f64; 12] {
    let mut sums = [0.0; POSE_SUMS];
    for group in pose_sums.chunks_exact(POSE_SUMS) {
        for (sum, &value) in sums.iter_mut().zip(group) {
            *sum += f64::from(value);
        }
    }
    let by_row = |i: usize| DVec3::new(sums[3 * i], sums[3 * i + 1], sums[3 * i + 2]);
    let (by_p, by_centre) = (by_row(3), by_row(4));
    let by_rotation = DMat3::from_cols(by_row(0), by_row(1), by_row(2)).transpose();
    let t = camera.translation();
    let mut out = [0.0; 12];
    for i in 0..3 {
        // A mean is what is relative plus the origin; the centre's entry j is -Σᵢ Rᵢⱼ tᵢ.
        let row = by_rotation.row(i) + by_p[i] * origin - t[i] * by_centre;
        out[4 * i..][..3].copy_from_slice(&row.to_array());
        out[4 * i + 3] = by_p[i] - camera.rotation().row(i).dot(by_centre);
    }
    out
}
