//! The uniform that all passes of a view share.

use crate::RenderSettings;
use crate::settings::COMPENSATION_MIN;
use glam::DVec3;
use gs_scene::Camera;
use gs_shaders::{Frame, TILE};

/// The frame of a view of a scene whose means are relative to `origin`.
pub(super) fn frame(
    camera: &Camera,
    settings: &RenderSettings,
    origin: DVec3,
    n_gaussians: u32,
    pair_capacity: u32,
) -> Frame {
    let lens = camera.intrinsics();
    let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
    let size = [lens.width as u32, lens.height as u32];
    let rotation = camera.rotation();
    let translation = rotation * origin + camera.translation();
    let pose = [0, 1, 2].map(|row| {
        let [x, y, z] = rotation.row(row).as_vec3().to_array();
        [x, y, z, translation[row] as f32]
    });
    let margin = |axis: usize| 0.15 * f64::from(size[axis]) / focal[axis];
    Frame {
        pose,
        position: (camera.position() - origin).as_vec3().to_array(),
        n_gaussians,
        focal: focal.map(|value| value as f32),
        centre: centre.map(|value| value as f32),
        slope_min: [0, 1].map(|axis| (-centre[axis] / focal[axis] - margin(axis)) as f32),
        slope_max: [0, 1]
            .map(|axis| ((f64::from(size[axis]) - centre[axis]) / focal[axis] + margin(axis)) as f32),
        size,
        tiles: size.map(|pixels| pixels.div_ceil(TILE)),
        background: settings.background,
        near: settings.near,
        far: settings.far,
        eps2d: settings.eps2d,
        alpha_max: settings.alpha_max,
        alpha_min: settings.alpha_min,
        transmittance_min: settings.transmittance_min,
        compensation_min: COMPENSATION_MIN,
        pair_capacity,
        padding: 0,
    }
}
