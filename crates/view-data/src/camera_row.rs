//! The camera as RealEstate10K writes it, in text and in chunks: `fx/W fy/H cx/W cy/H 0 0`, then the 3×4
//! world-to-camera matrix row by row, OpenCV axes.

use crate::dataset::nearest_rotation;
use crate::{Lens, LensModel, PoseRule};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Intrinsics};

/// Numbers of a row.
pub(crate) const COLUMNS: usize = 18;
/// Largest entry of the translation, scene units. Scenes beyond it are failed reconstructions; DepthSplat draws the
/// line at the same place, for positive entries alone.
pub(crate) const MAX_TRANSLATION: f64 = 1e3;

/// The rules of a camera row that can be broken. Columns count from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraRule {
    /// A number is NaN or infinite.
    #[error("column {column} of the camera is not finite")]
    NotFinite {
        /// The column.
        column: usize,
    },
    /// Columns 4 and 5 are not 0.
    #[error("column {column} of the camera is {found}, expected 0 (lens distortion is not read)")]
    Unused {
        /// The column.
        column: usize,
        /// The value.
        found: f64,
    },
    /// A translation far beyond any reconstruction that succeeded.
    #[error("translation of the camera is {found}, expected entries within ±{MAX_TRANSLATION}")]
    Translation {
        /// The entry.
        found: f64,
    },
    /// The 3×3 part of the pose is no rotation, uniform scale and rounded digits allowed for.
    #[error(
        "pose holds no rotation: |R Rᵀ - I| is {deviation:.2e} after a uniform scale is taken out, expected at most 1e-2"
    )]
    NotARotation {
        /// Largest absolute entry of `R Rᵀ - I`.
        deviation: f64,
    },
    /// The 3×3 part of the pose mirrors.
    #[error("pose mirrors the scene (its determinant is negative)")]
    Mirrored,
    /// The numbers make no camera.
    #[error("the camera is not valid: {0}")]
    Camera(Box<gs_scene::Error>),
}

/// The camera of a row.
#[derive(Clone, Copy)]
pub(crate) struct RowCamera {
    pub(crate) lens: Lens,
    /// Columns are the camera's axes in the world.
    pub(crate) axes: DMat3,
    pub(crate) position: DVec3,
}

/// Checks a row and brings it to a picture's size, pixels.
pub(crate) fn read_row(row: &[f64; COLUMNS], size: (usize, usize)) -> Result<RowCamera, CameraRule> {
    if let Some(column) = row.iter().position(|value| !value.is_finite()) {
        return Err(CameraRule::NotFinite { column });
    }
    if let Some(column) = [4, 5].into_iter().find(|&column| row[column] != 0.0) {
        return Err(CameraRule::Unused { column, found: row[column] });
    }
    let translation = DVec3::new(row[9], row[13], row[17]);
    if let Some(found) = translation.to_array().into_iter().find(|entry| entry.abs() > MAX_TRANSLATION) {
        return Err(CameraRule::Translation { found });
    }
    // The transpose of world-to-camera is camera-to-world: rows become the axes.
    let axis = |first: usize| DVec3::new(row[first], row[first + 1], row[first + 2]);
    let rows = DMat3::from_cols(axis(6), axis(10), axis(14));
    let axes = nearest_rotation(rows).map_err(|rule| match rule {
        PoseRule::NotARotation { deviation } => CameraRule::NotARotation { deviation },
        _ => CameraRule::Mirrored,
    })?;
    let position = -(axes * translation);
    let (width, height) = size;
    let intrinsics = Intrinsics {
        fx: row[0] * width as f64,
        fy: row[1] * height as f64,
        cx: row[2] * width as f64,
        cy: row[3] * height as f64,
        width,
        height,
    };
    Camera::from_camera_to_world(intrinsics, axes, position)
        .map_err(|source| CameraRule::Camera(Box::new(source)))?;
    Ok(RowCamera { lens: Lens { intrinsics, model: LensModel::PINHOLE }, axes, position })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera turned by 90 degrees about y (it looks along the world's +x), at (3, 1, -2).
    const TURNED: [f64; COLUMNS] =
        [0.5, 0.75, 0.5, 0.25, 0.0, 0.0, 0.0, 0.0, -1.0, -2.0, 0.0, 1.0, 0.0, -1.0, 1.0, 0.0, 0.0, -3.0];

    #[test]
    fn intrinsics_scale_with_the_picture_and_the_pose_is_inverted() {
        let camera = read_row(&TURNED, (200, 100)).unwrap();
        let Intrinsics { fx, fy, cx, cy, .. } = camera.lens.intrinsics;
        assert_eq!((fx, fy, cx, cy), (100.0, 75.0, 100.0, 25.0));
        assert!((camera.position - DVec3::new(3.0, 1.0, -2.0)).length() < 1e-14, "{}", camera.position);
        assert!((camera.axes.z_axis - DVec3::X).length() < 1e-14);
    }

    #[test]
    fn every_rule_is_named() {
        let broken = |column: usize, value: f64| {
            let mut row = TURNED;
            row[column] = value;
            read_row(&row, (200, 100)).err().unwrap().to_string()
        };
        let nan = "column 7 of the camera is not finite";
        assert_eq!(broken(7, f64::NAN), nan);
        assert_eq!(broken(5, 0.1), "column 5 of the camera is 0.1, expected 0 (lens distortion is not read)");
        for far in [1.1e3, -1.1e3] {
            assert!(broken(13, far).starts_with(&format!("translation of the camera is {far},")));
        }
        assert!(broken(8, -3.0).starts_with("pose holds no rotation"));
        assert!(broken(8, 1.0).starts_with("pose mirrors"));
        assert!(broken(0, 0.0).starts_with("the camera is not valid"));
    }
}
