/// Why pixels have no anchors or normals.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Depth map and camera do not have the same size.
    #[error("depth map is {found_width}x{found_height}, its camera is {width}x{height}")]
    SizeMismatch {
        /// Camera's width.
        width: usize,
        /// Camera's height.
        height: usize,
        /// Depth map's width.
        found_width: usize,
        /// Depth map's height.
        found_height: usize,
    },
    /// Not one normal per pixel.
    #[error("{found} normals, expected one for each of {expected} pixels")]
    NormalCount {
        /// Pixels of the depth map.
        expected: usize,
        /// Normals given.
        found: usize,
    },
    /// A chosen pixel that the image does not have.
    #[error("pixel {pixel} of view {view} is outside the image of {pixels} pixels")]
    PixelOutside {
        /// The view.
        view: u32,
        /// Index of the pixel.
        pixel: u32,
        /// Pixels of the image.
        pixels: usize,
    },
    /// A chosen pixel without depth.
    #[error("pixel {pixel} of view {view} has no depth: give it weight 0 when sampling, or fill the hole")]
    NoDepth {
        /// The view.
        view: u32,
        /// Index of the pixel.
        pixel: u32,
    },
    /// A window without a middle, or without neighbours.
    #[error("normal window is {found} pixels wide, expected an odd number from 3 to 31")]
    WindowSize {
        /// The size given.
        found: usize,
    },
    /// A step that is no share of a depth.
    #[error("largest relative step in depth is {found}, expected a number above 0")]
    RelativeStep {
        /// The value given.
        found: f32,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
