/// Why depth could not be estimated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No views at all.
    #[error("no views given, expected at least one")]
    NoViews,
    /// Stereo from a single view.
    #[error("plane-sweep stereo needs at least two views, found one: give more views, or measured depth")]
    OneView,
    /// `given-depth` without depth.
    #[error("view {view} has no measured depth: use the plane-sweep backbone, or data with depth")]
    NoDepth {
        /// Name of the view.
        view: String,
    },
    /// The near and far plane do not make a range.
    #[error("depth range is {near}..{far}, expected finite numbers with 0 < near < far")]
    Range {
        /// Near plane, scene units.
        near: f64,
        /// Far plane, scene units.
        far: f64,
    },
    /// All cameras stand in one place, or see nothing in common.
    #[error(
        "the depth range cannot be estimated: {reason}; state it (--depth-range NEAR,FAR), or give views that overlap"
    )]
    RangeUnknown {
        /// What was found.
        reason: &'static str,
    },
    /// A view has a NaN or an infinite pixel.
    #[error("view {view}: pixel ({x}, {y}) is not finite")]
    PixelNotFinite {
        /// Name of the view.
        view: String,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// A setting outside its range.
    #[error("{setting} is {found}, expected {expected}")]
    Setting {
        /// Name of the field.
        setting: &'static str,
        /// The value given.
        found: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// A map does not fit its picture.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
