/// Why pixels have no anchors or normals.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Not one depth per pixel of the camera.
    #[error("depth of view {view} holds {found} numbers, its camera has {width}x{height} pixels")]
    DepthCount {
        /// The view.
        view: usize,
        /// Camera's width.
        width: usize,
        /// Camera's height.
        height: usize,
        /// Depths given.
        found: usize,
    },
    /// Image and camera do not have the same size.
    #[error("image of view {view} is {found_width}x{found_height}, its camera is {width}x{height}")]
    ImageSize {
        /// The view.
        view: usize,
        /// Camera's width.
        width: usize,
        /// Camera's height.
        height: usize,
        /// Image's width.
        found_width: usize,
        /// Image's height.
        found_height: usize,
    },
    /// Some views have it, others do not: the arrays would not line up.
    #[error("view {view} differs from view 0 in having {what} or not, expected {what} for all views or none")]
    Missing {
        /// The first view that differs from view 0.
        view: usize,
        /// "an image" or "features".
        what: &'static str,
    },
    /// Feature maps that do not have the same number of channels.
    #[error("features of view {view} have {found} channels, those of view 0 have {expected}")]
    Channels {
        /// The view.
        view: usize,
        /// Channels of view 0.
        expected: usize,
        /// Channels of this view.
        found: usize,
    },
    /// A chosen pixel that the image does not have.
    #[error("pixel {pixel} of view {view} is outside the image of {pixels} pixels")]
    PixelOutside {
        /// The view.
        view: usize,
        /// Index of the pixel.
        pixel: u32,
        /// Pixels of the image.
        pixels: usize,
    },
    /// A focal length, principal point or pose so extreme that points would not be finite.
    #[error("camera of view {view} puts points of depth up to 3.4e38 beyond the range of f64")]
    CameraRange {
        /// The view.
        view: usize,
    },
    /// A largest depth that is none.
    #[error("farthest depth is {found}, expected a number above 0 (infinity for no limit)")]
    Far {
        /// The value given.
        found: f32,
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
