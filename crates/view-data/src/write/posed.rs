//! Writes what describes photographs that lie in a folder: poses, lenses and points that somebody estimated.

use super::{WriteRule, broken, colmap, nerfstudio};
use crate::{Result, ScenePoint};
use gs_scene::{Camera, Lens};
use std::collections::HashSet;
use std::path::Path;

/// A photograph `images/NAME` with its camera.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedFrame {
    /// File name of the picture in `images/`.
    pub picture: String,
    /// Intrinsics and distortion, for the picture's size.
    pub lens: Lens,
    /// Pose; its intrinsics are those of the lens.
    pub camera: Camera,
}

/// Writes `transforms.json` and COLMAP's `sparse/0/{cameras,images,points3D}.bin` into a folder that holds the pictures in `images/`. Both
/// files describe the same cameras. Depth percentiles come from the points.
///
/// Observations of the points name frames by their position in `frames`.
///
/// # Errors
/// If there are no frames, two have one picture, the layouts cannot hold a lens, or a file cannot be written.
///
/// # Panics
/// If an observation names a frame that is not there.
pub fn write_posed(folder: &Path, frames: &[PosedFrame], points: &[ScenePoint]) -> Result<()> {
    if frames.is_empty() {
        return Err(broken(folder, WriteRule::Empty));
    }
    let mut names = HashSet::new();
    for frame in frames {
        let name = &frame.picture;
        if !names.insert(name) || name.contains(['/', '\\', '\0', '\n']) {
            return Err(broken(folder, WriteRule::FrameName { name: name.clone() }));
        }
        if frame.lens.model.radial_tangential().is_none() {
            return Err(broken(folder, WriteRule::LensModel { frame: name.clone() }));
        }
    }
    nerfstudio::Transforms::of_posed(frames, points).finish(folder)?;
    colmap::Model::of_posed(frames, points).finish(folder)
}
