use crate::Result;
use crate::error::check;
use crate::search::search;
use gs_scene::Camera;

/// Pixels that were lifted into the world: four arrays of the same length, in any order of views. The anchors of crate
/// backproject have these arrays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchors<'a> {
    /// Positions, world axes, scene units.
    pub positions: &'a [[f64; 3]],
    /// Index of the view that each anchor is a pixel of.
    pub views: &'a [u32],
    /// Index (row-major) of the pixel in its view.
    pub pixels: &'a [u32],
    /// z-depth in its view, scene units.
    pub depths: &'a [f32],
}

/// Which anchors are neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Most neighbours of an anchor, of all views together.
    pub k: usize,
    /// Largest distance from an anchor's projection to a neighbour's pixel centre, pixels of the neighbour's view.
    pub radius: f64,
    /// How far an anchor may lie behind its neighbour, as seen from the neighbour's view: the share of the neighbour's depth.
    pub tolerance: f64,
}

/// The neighbours of every anchor, nearest first; equal distances by ascending index.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbors {
    /// `[rows + 1]`: where each row starts in the other arrays, and where the last one ends.
    pub starts: Vec<usize>,
    /// Indices of the neighbours, row after row.
    pub indices: Vec<u32>,
    /// Squared distances in the neighbour's view, square pixels, computed in f64 and rounded.
    pub sq_distances: Vec<f32>,
}

impl Neighbors {
    /// Number of rows: one per anchor.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// Indices and squared distances of one anchor's neighbours, nearest first.
    ///
    /// # Panics
    /// If there is no such row.
    #[must_use]
    pub fn row(&self, row: usize) -> (&[u32], &[f32]) {
        assert!(row < self.rows(), "row {row} of {}", self.rows());
        let range = self.starts[row]..self.starts[row + 1];
        (&self.indices[range.clone()], &self.sq_distances[range])
    }
}

/// The neighbours of every anchor in the views of `cameras` that it is no pixel of.
///
/// # Errors
/// If the arrays differ in length, an anchor's view or pixel does not exist, a position or depth is not finite, the
/// radius or the tolerance is negative or not finite, or the anchors are more than a `u32` can index.
pub fn neighbors(anchors: &Anchors, cameras: &[Camera], settings: &Settings) -> Result<Neighbors> {
    check(anchors, cameras, settings)?;
    Ok(search(anchors, cameras, settings))
}

/// The squared distance from a projection to a pixel's centre, square pixels.
pub(crate) fn sq_distance(projection: [f64; 2], column: f64, row: f64) -> f64 {
    let (dx, dy) = (column + 0.5 - projection[0], row + 0.5 - projection[1]);
    dx * dx + dy * dy
}
