/// Why a scene was not refined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Nothing to compare the scene with.
    #[error("no context views: refinement needs at least one photograph")]
    NoViews,
    /// A setting outside its range.
    #[error("refinement setting {name} is {found}, expected {expected}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        found: f64,
        /// Its range.
        expected: &'static str,
    },
    /// The scene cannot be rendered or differentiated.
    #[error(transparent)]
    Raster(#[from] gs_raster::Error),
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
