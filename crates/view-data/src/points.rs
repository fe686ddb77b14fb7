//! Points of the scene that are part of a data set.

use crate::colmap::{ModelFiles, read_points};
use crate::{Dataset, Result};
use glam::{DVec2, DVec3};
use std::path::PathBuf;

/// A point of the scene, triangulated by whoever made the data set.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePoint {
    /// Position in the world, scene units.
    pub position: DVec3,
    /// sRGB colour; `None` if the file has none.
    pub colour: Option<[u8; 3]>,
    /// Mean reprojection error as the file states it, pixels.
    pub error: Option<f64>,
    /// The frames that see it; empty where the file does not say.
    pub observations: Vec<Observation>,
}

/// A sighting of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Position of the frame in [`Dataset::frames`].
    pub frame: usize,
    /// Where it is seen: pixels of the picture as it lies on disk (before undistortion), at the size of
    /// [`Frame::lens`](crate::Frame::lens).
    pub pixel: DVec2,
}

/// Where points are read from when they are asked for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum PointSource {
    /// A model of COLMAP's; for each image of the file the position of its frame.
    Colmap { files: ModelFiles, position_of: Vec<usize> },
    /// A PLY file.
    Ply(PathBuf),
}

impl Dataset {
    /// Whether the data set has points.
    #[must_use]
    pub fn has_points(&self) -> bool {
        self.points.is_some()
    }

    /// Reads the points of the scene; `None` if the data set has none. They are not kept: call this once.
    ///
    /// # Errors
    /// If the file cannot be read or breaks a rule of its format.
    pub fn points(&self) -> Result<Option<Vec<ScenePoint>>> {
        let mut points = match &self.points {
            None => return Ok(None),
            Some(PointSource::Ply(path)) => crate::ply::read_points(path)?,
            Some(PointSource::Colmap { files, position_of }) => read_points(files, position_of)?,
        };
        let offset = self.offset.unwrap_or_default();
        points.iter_mut().for_each(|point| point.position -= offset);
        Ok(Some(points))
    }
}
