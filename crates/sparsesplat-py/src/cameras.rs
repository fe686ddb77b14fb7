//! Matrices of cameras as gsplat takes them.

use crate::arrays::{Side, read_f64};
use crate::failure::OrRaise;
use glam::{DMat3, DVec3};
use gs_raster::CameraGradient;
use gs_scene::{Camera, Intrinsics};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The cameras of a batch.
#[derive(Debug, Clone)]
pub(crate) struct Cameras {
    pub(crate) all: Vec<Camera>,
    /// Whether the matrices were float64; gradients by them are what they are.
    pub(crate) is_double: bool,
}

impl Cameras {
    /// From world-to-camera matrices `[C, 4, 4]` and intrinsics `[C, 3, 3]`, pixels.
    ///
    /// # Errors
    /// As [`camera`], with the number of the camera; shapes and dtypes as everywhere.
    pub(crate) fn read(
        viewmats: &Bound<'_, PyAny>,
        ks: &Bound<'_, PyAny>,
        width: usize,
        height: usize,
    ) -> PyResult<Self> {
        let (poses, is_double) = read_f64("viewmats", viewmats, &[Side::Any("C"), Side::Is(4), Side::Is(4)])?;
        let count = poses.len() / 16;
        let (lenses, _) = read_f64("Ks", ks, &[Side::Is(count), Side::Is(3), Side::Is(3)])?;
        let each = poses.chunks_exact(16).zip(lenses.chunks_exact(9)).enumerate();
        let all = each.map(|(index, (pose, lens))| {
            camera(pose, lens, width, height).map_err(|error| {
                PyValueError::new_err(format!("camera {index}: {}", error.value(viewmats.py())))
            })
        });
        Ok(Self { all: all.collect::<PyResult<_>>()?, is_double })
    }
}

/// A camera of a world-to-camera matrix, row-major 4×4, and intrinsics, row-major 3×3.
///
/// # Errors
/// If the last rows are not (0, 0, 0, 1) and (0, 0, 1), the lens has skew, or the camera is none.
pub(crate) fn camera(pose: &[f64], lens: &[f64], width: usize, height: usize) -> PyResult<Camera> {
    if pose[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(PyValueError::new_err(format!(
            "the last row of the world-to-camera matrix is {:?}, expected [0, 0, 0, 1]",
            &pose[12..]
        )));
    }
    if lens[6..] != [0.0, 0.0, 1.0] || lens[3] != 0.0 || lens[1] != 0.0 {
        return Err(PyValueError::new_err(format!(
            "the intrinsics are {lens:?}, expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] without skew"
        )));
    }
    let row = |start: usize| DVec3::new(pose[start], pose[start + 1], pose[start + 2]);
    let rotation = DMat3::from_cols(row(0), row(4), row(8)).transpose();
    let translation = DVec3::new(pose[3], pose[7], pose[11]);
    let lens = Intrinsics { fx: lens[0], fy: lens[4], cx: lens[2], cy: lens[5], width, height };
    Camera::new(lens, rotation, translation).or_raise()
}

/// The world-to-camera matrix of a camera, row-major 4×4.
pub(crate) fn pose(camera: &Camera) -> Vec<f64> {
    rows(camera.rotation(), camera.translation(), 1.0)
}

/// The intrinsics of a camera, row-major 3×3, pixels.
pub(crate) fn lens(camera: &Camera) -> Vec<f64> {
    let Intrinsics { fx, fy, cx, cy, .. } = *camera.intrinsics();
    vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
}

/// Gradients by a world-to-camera matrix, row-major 4×4. The last row is no argument of anything.
pub(crate) fn pose_gradient(gradient: &CameraGradient) -> Vec<f64> {
    rows(gradient.rotation, gradient.translation, 0.0)
}

fn rows(rotation: DMat3, translation: DVec3, corner: f64) -> Vec<f64> {
    let mut all = Vec::with_capacity(16);
    for row in 0..3 {
        all.extend(rotation.row(row).to_array());
        all.push(translation[row]);
    }
    all.extend([0.0, 0.0, 0.0, corner]);
    all
}
