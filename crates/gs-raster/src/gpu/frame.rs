//! The uniform that all passes of a view share.

use crate::settings::ELLIPSOID_AMBIENT;
use crate::{ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, RenderSettings, SLOPE_MARGIN, Style};
use gs_scene::Camera;
use gs_shaders::{AMBIENT, Frame, TILE};

const _: () = assert!(TILE as usize == crate::TILE, "pictures are cut alike on CPU and GPU");
const _: () = assert!(AMBIENT == ELLIPSOID_AMBIENT, "ellipsoids are lit alike on CPU and GPU");

/// The frame of a view of a scene.
pub(super) fn frame(
    camera: &Camera,
    settings: &RenderSettings,
    n_gaussians: u32,
    pair_capacity: u32,
) -> Frame {
    let lens = camera.intrinsics();
    let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
    let size = [lens.width as u32, lens.height as u32];
    let rows = [0, 1, 2].map(|row| {
        let [x, y, z] = camera.rotation().row(row).to_array();
        [x, y, z, camera.translation()[row]]
    });
    let position = camera.position().to_array();
    let margin = |axis: usize| SLOPE_MARGIN * f64::from(size[axis]) / focal[axis];
    Frame {
        pose: rows.map(high),
        pose_low: rows.map(low),
        position: high(position),
        n_gaussians,
        position_low: low(position),
        near: settings.near,
        focal: high(focal),
        focal_low: low(focal),
        centre: high(centre),
        centre_low: low(centre),
        slope_min: high([0, 1].map(|axis| -centre[axis] / focal[axis] - margin(axis))),
        slope_max: high(
            [0, 1].map(|axis| (f64::from(size[axis]) - centre[axis]) / focal[axis] + margin(axis)),
        ),
        size,
        tiles: size.map(|pixels| pixels.div_ceil(TILE)),
        background: settings.background,
        // WGSL may assume that there are no infinities.
        far: settings.far.min(f32::MAX),
        eps2d: settings.eps2d,
        alpha_max: settings.alpha_max,
        alpha_min: match settings.style {
            Style::Blended => settings.alpha_min,
            Style::Ellipsoids => ELLIPSOID_OPACITY_MIN,
        },
        transmittance_min: settings.transmittance_min,
        compensation_min: settings.compensation_min,
        pair_capacity,
        zero: 0,
        ellipsoid_sigma: ELLIPSOID_SIGMA,
    }
}

/// The nearest f32.
fn high<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

/// What the nearest f32 leaves over.
fn low<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| (value - f64::from(value as f32)) as f32)
}
