//! The parts of a rendering.

use gs_scene::Image;
use serde::Serialize;

/// A rendered view.
#[derive(Debug, Clone)]
pub struct Rendering {
    /// Colour over the background, not clipped.
    pub image: Image,
    /// Opacity `[height, width]`: 1 minus the transmittance that is left. Of ellipsoids, 1 where there is one.
    pub alpha: Vec<f32>,
    /// Expected z-depth `[height, width]`, scene units: Σ w z / Σ w over the Gaussians drawn in a pixel, 0 where
    /// there are none; of ellipsoids, that of the front. Only when [`RenderSettings::depth`](crate::RenderSettings::depth)
    /// asks for it.
    pub depth: Option<Vec<f32>>,
    /// What was drawn, and the time it took.
    pub stats: RenderStats,
}

/// Side of the tiles that pictures are cut into, pixels.
pub const TILE: usize = 16;

/// Counts and times of one rendering.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct RenderStats {
    /// Gaussians that may touch a pixel: between near and far, not too transparent, footprint in the image. Devices may
    /// bound those that just miss it differently.
    pub visible: usize,
    /// Gaussians left out because a stored value is not finite, the quaternion is zero, or a scale, the
    /// footprint or the colour overflows.
    pub rejected: usize,
    /// Pairs of a Gaussian and a tile of [`TILE`] pixels that its footprint may touch.
    pub intersections: u64,
    /// Wall time of the stages.
    pub seconds: StageSeconds,
}

/// Wall time of the stages of one rendering, seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct StageSeconds {
    /// Gaussians to footprints and colours.
    pub project: f64,
    /// Lists of Gaussians per tile.
    pub bin: f64,
    /// Near-to-far order within each tile, and compositing.
    pub blend: f64,
    /// Everything on the GPU, from the first command to the picture in memory; 0 on the CPU, as the others are on the GPU.
    pub gpu: f64,
}
