//! A data set as every reader delivers it: where the files are, and how they were taken.

use crate::{Error, Lens, Result, TransformsRule};
use glam::{DAffine3, DMat3, DVec3};
use gs_scene::Camera;
use std::path::PathBuf;

/// The frames of a data set and where their files are; the pictures themselves are read by
/// [`Dataset::load_views`].
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Name of the folder.
    pub name: String,
    /// The file that lists the frames.
    pub file: PathBuf,
    /// The folder that holds it.
    pub root: PathBuf,
    /// The frames in the file's order: an evaluation index counts positions in it.
    pub frames: Vec<Frame>,
    /// Depths of the scene as the file states them (key `scene_depth_percentiles`).
    pub depth_percentiles: Option<DepthPercentiles>,
    /// The transform from the original (COLMAP) world to the world of the poses, where the file records one
    /// (`applied_transform`). The poses contain it already; it is kept so that a result can say its frame.
    pub applied_transform: Option<DAffine3>,
    /// The scale that the poses contain beside it (`applied_scale`).
    pub applied_scale: Option<f64>,
}

/// One posed photograph of a data set, not yet read.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Stem of the picture's file name; where two frames share it, the whole relative path with `_` for `/`.
    pub name: String,
    /// The picture, PNG or JPEG.
    pub image_path: PathBuf,
    /// Measured z-depth, where there is one.
    pub depth: Option<DepthFile>,
    /// A mask, where there is one (black = ignore). It is recorded, not applied.
    pub mask_path: Option<PathBuf>,
    /// Intrinsics and distortion, for the stated picture size.
    pub lens: Lens,
    /// The camera's x (right), y (down) and z (forward) axis in the world, as columns.
    pub axes: DMat3,
    /// The camera centre in the world, scene units.
    pub position: DVec3,
}

/// A file of measured z-depth: 16-bit greyscale PNG, 0 = no measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFile {
    /// The file.
    pub path: PathBuf,
    /// Scene units per count.
    pub unit: f64,
}

/// Camera depths of the scene's points, scene units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPercentiles {
    /// 0.5 % of the points are nearer.
    pub p0_5: f64,
    /// 2 % are nearer.
    pub p2: f64,
    /// Half of them are nearer.
    pub p50: f64,
    /// 98 % are nearer.
    pub p98: f64,
    /// 99.5 % are nearer.
    pub p99_5: f64,
}

impl Frame {
    /// The frame's camera at the stated picture size, its distortion left out: where the frame looks, before any
    /// picture is read. The exact camera of the pixels comes with [`Dataset::load_views`].
    ///
    /// # Errors
    /// If the numbers make no camera; those of a frame from a reader do.
    pub fn camera(&self) -> gs_scene::Result<Camera> {
        Camera::from_camera_to_world(self.lens.intrinsics, self.axes, self.position)
    }
}

impl Dataset {
    /// [`Frame::camera`] of every frame.
    ///
    /// # Errors
    /// If the numbers of a frame make no camera.
    pub fn cameras(&self) -> Result<Vec<Camera>> {
        let camera = |frame: &Frame| {
            frame.camera().map_err(|source| Error::View { frame: frame.name.clone(), source })
        };
        self.frames.iter().map(camera).collect()
    }

    /// The frame at a position.
    ///
    /// # Errors
    /// If there is none.
    pub fn frame(&self, position: usize) -> Result<&Frame> {
        self.frames.get(position).ok_or_else(|| Error::Position {
            name: self.name.clone(),
            position,
            frames: self.frames.len(),
        })
    }
}

/// The rotation nearest to a matrix that is one up to a uniform positive scale and rounded digits: the polar factor,
/// by Newton's iteration X ← (X + X⁻ᵀ) / 2.
///
/// The scale is taken out because no pixel depends on it (a scaled camera object in Blender writes one).
pub(crate) fn nearest_rotation(matrix: DMat3) -> std::result::Result<DMat3, TransformsRule> {
    let determinant = matrix.determinant();
    if determinant < 0.0 {
        return Err(TransformsRule::Mirrored);
    }
    let mut rotation = matrix * determinant.cbrt().recip();
    let gram = rotation * rotation.transpose() - DMat3::IDENTITY;
    let deviation = gram.to_cols_array().into_iter().fold(0.0, |worst: f64, entry| worst.max(entry.abs()));
    // A zero matrix gives NaN, which `max` passes over.
    if deviation > ROUNDED_ROTATION || !rotation.is_finite() {
        return Err(TransformsRule::NotARotation { deviation });
    }
    // Convergence is quadratic: 1e-2, 1e-4, 1e-8, 1e-16.
    for _ in 0..5 {
        rotation = (rotation + rotation.inverse().transpose()) * 0.5;
    }
    Ok(rotation)
}

/// Largest entry of `R Rᵀ - I` that is taken for rounded digits (three decimals give a few 1e-3).
const ROUNDED_ROTATION: f64 = 1e-2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_and_scaled_rotations_are_mended_and_others_refused() {
        let exact = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0);
        let rounded = DMat3::from_cols_array(&exact.to_cols_array().map(|v| (v * 1e3).round() / 1e3));
        for input in [exact, rounded, rounded * 2.5, exact * 1e-3] {
            let mended = nearest_rotation(input).unwrap();
            let gram = mended * mended.transpose() - DMat3::IDENTITY;
            assert!(gram.to_cols_array().iter().all(|entry| entry.abs() < 1e-14));
            assert!((mended - exact).to_cols_array().iter().all(|entry| entry.abs() < 1e-3));
        }
        let sheared = exact * DMat3::from_diagonal(DVec3::new(1.1, 1.0, 1.0));
        for broken in [sheared, DMat3::ZERO, DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)), exact * 1e200] {
            assert!(matches!(nearest_rotation(broken), Err(TransformsRule::NotARotation { .. })), "{broken}");
        }
        assert!(matches!(nearest_rotation(-exact), Err(TransformsRule::Mirrored)));
    }
}
