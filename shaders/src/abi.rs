//! What crosses the border between Rust and WGSL: structs as the shaders see them, and the places in flat buffers. A test
//! compares sizes, offsets and constants with the shaders.

use bytemuck::{Pod, Zeroable};

/// What all passes of a view share.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
pub struct Frame {
    /// Rows of the world-to-camera matrix [R | t].
    pub pose: [[f32; 4]; 3],
    /// What f32 leaves over of it.
    pub pose_low: [[f32; 4]; 3],
    /// Camera centre, scene units.
    pub position: [f32; 3],
    /// Gaussians in the scene.
    pub n_gaussians: u32,
    /// What f32 leaves over of the camera centre.
    pub position_low: [f32; 3],
    /// Gaussians at this z-depth or nearer are not drawn, scene units.
    pub near: f32,
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// What f32 leaves over of them.
    pub focal_low: [f32; 2],
    /// Principal point, pixels.
    pub centre: [f32; 2],
    /// What f32 leaves over of it.
    pub centre_low: [f32; 2],
    /// Least x/z and y/z at which the projection is linearised.
    pub slope_min: [f32; 2],
    /// Largest x/z and y/z at which the projection is linearised.
    pub slope_max: [f32; 2],
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Columns and rows of tiles.
    pub tiles: [u32; 2],
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Gaussians at this z-depth or farther are not drawn, scene units.
    pub far: f32,
    /// Variance of the low-pass filter, square pixels.
    pub eps2d: f32,
    /// Largest opacity of one Gaussian in one pixel.
    pub alpha_max: f32,
    /// Below this opacity in a pixel a Gaussian is not drawn there.
    pub alpha_min: f32,
    /// A pixel is done before the Gaussian that would take its transmittance below this.
    pub transmittance_min: f32,
    /// Least factor of the compensation for the low-pass filter.
    pub compensation_min: f32,
    /// Pairs of Gaussian and tile for which there is room.
    pub pair_capacity: u32,
    /// 0, which no shader compiler can know: it keeps roundings where they are.
    pub zero: u32,
    /// Size at which ellipsoids are drawn, standard deviations.
    pub ellipsoid_sigma: f32,
}

/// The footprint of a Gaussian. In a pixel at (dx, dy) from the centre, with e = dx - shear dy, log₂ of alpha is
/// `log2_opacity + falloff[0] e² + falloff[1] dy²`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
pub struct Splat {
    /// Centre, pixels.
    pub mean: [f32; 2],
    /// What f32 leaves over of it.
    pub mean_low: [f32; 2],
    /// Factors of e² and dy², negative, 1 / square pixels.
    pub falloff: [f32; 2],
    /// dx of the middle of the ellipse's row at dy = 1.
    pub shear: f32,
    /// What f32 leaves over of it.
    pub shear_low: f32,
    /// log₂ of the opacity, compensated if asked for.
    pub log2_opacity: f32,
    /// Colour, not negative.
    pub rgb: [f32; 3],
    /// z-depth of the centre, scene units.
    pub depth: f32,
    /// Nothing.
    pub padding: f32,
}

/// A Gaussian as an ellipsoid, in the affine view in which its footprint is an ellipse. With e = dx - shear dy and the exponent
/// m = A e² + g dy² of the footprint, its front is at z-depth
/// `depth + slope_e e + slope_y dy - sigma_z √(ellipsoid_sigma² - m)`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
pub struct Surface {
    /// Scene units / pixel.
    pub slope_e: f32,
    /// Scene units / pixel.
    pub slope_y: f32,
    /// Standard deviation along the ray, scene units.
    pub sigma_z: f32,
    /// Nothing.
    pub padding: f32,
}

/// Uniform of the pass `scan`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Scan {
    /// Numbers to scan.
    pub n: u32,
    /// Blocks of `WORKGROUP · ITEMS` numbers.
    pub n_blocks: u32,
    /// Slot of the counters for the total, or [`NOWHERE`].
    pub total: u32,
    /// Nothing.
    pub padding: u32,
}

/// Uniform of the pass `sort`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Sort {
    /// Keys for which there is room.
    pub n: u32,
    /// Blocks of `WORKGROUP · ITEMS` keys.
    pub n_blocks: u32,
    /// Slot of the counters that has the number of keys; [`NOWHERE`]: `n`.
    pub count: u32,
    /// Position of the digit's lowest bit.
    pub shift: u32,
}

/// Numbers per Gaussian in the geometry buffer.
pub const GEOMETRY: usize = 11;
/// Numbers per pixel in the buffer of pixel gradients: colour (3), transmittance, Σ w z, and the transmittance itself.
pub const PIXEL_GRADS: usize = 6;
/// Numbers per pair in the buffer of footprint gradients.
pub const PAIR_GRADS: usize = 10;
/// Numbers per workgroup in the sums by the pose.
pub const POSE_SUMS: usize = 15;

/// Counters of a view.
pub const N_COUNTERS: usize = 3;
/// Slot of the counters: Gaussians that may touch a pixel.
pub const VISIBLE: u32 = 0;
/// Slot of the counters: Gaussians left out because something is not finite.
pub const REJECTED: u32 = 1;
/// Slot of the counters: pairs of Gaussian and tile, 2³² - 1 if there are more.
pub const N_PAIRS: u32 = 2;
/// No slot.
pub const NOWHERE: u32 = u32::MAX;
/// Depth key of a Gaussian that is not visible.
pub const CULLED: u32 = u32::MAX;

/// Longest standard deviation of a footprint, pixels.
pub const SIGMA_MAX: f32 = 1e9;
/// Share of the colour that a surface of an ellipsoid keeps which is seen edge-on.
pub const AMBIENT: f32 = 0.3;
/// What is added to the level of the ellipse that bounds a footprint, in units of log₂ of alpha.
pub const LEVEL_SLACK: f32 = 1e-3;
/// Added to the reach of an ellipse, relative to the numbers that it is the difference of.
pub const REACH_SLACK: f32 = 1e-6;
