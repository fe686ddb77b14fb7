//! A sparse grid of a frame's pixels that have depth.

use glam::{DVec2, DVec3};
use gs_scene::{DepthMap, Lens, View};

/// Cells along each side of a picture; a cell has at most one sample.
pub(super) const CELLS: usize = 20;

/// A pixel with depth.
pub(super) struct Sample {
    /// Centre of the pixel.
    pub(super) pixel: DVec2,
    /// Along the camera's z axis, scene units.
    pub(super) depth: f64,
    /// In the world.
    pub(super) position: DVec3,
    pub(super) colour: [u8; 3],
}

/// The pixel nearest to the middle of each cell, where it has depth.
pub(super) fn samples(view: &View, lens: &Lens) -> impl Iterator<Item = (usize, Sample)> {
    let (width, height) = (view.image().width(), view.image().height());
    (0..CELLS * CELLS).filter_map(move |cell| {
        let middle = |index: usize, side: usize| (2 * index + 1) * side / (2 * CELLS);
        let (x, y) = (middle(cell % CELLS, width), middle(cell / CELLS, height));
        let depth = depth_at(view.depth()?, x, y)?;
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let position = view.camera().to_world(lens.undistort(pixel)?.extend(1.0) * depth);
        let start = (y * width + x) * 3;
        let colour = std::array::from_fn(|channel| {
            (view.image().data()[start + channel].clamp(0.0, 1.0) * 255.0).round() as u8
        });
        Some((cell, Sample { pixel, depth, position, colour }))
    })
}

/// The cell of a pixel position inside the picture.
pub(super) fn cell_of(pixel: DVec2, lens: &Lens) -> usize {
    let index = |v: f64, side: usize| ((v / side as f64 * CELLS as f64) as usize).min(CELLS - 1);
    index(pixel.y, lens.intrinsics.height) * CELLS + index(pixel.x, lens.intrinsics.width)
}

/// The depth of a pixel, if it was measured.
pub(super) fn depth_at(depth: &DepthMap, x: usize, y: usize) -> Option<f64> {
    let z = depth.data()[y * depth.width() + x];
    (z > 0.0).then(|| f64::from(z))
}
