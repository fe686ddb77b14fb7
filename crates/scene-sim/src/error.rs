/// What can be wrong with a scene description or a request to render it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number of the description is NaN, infinite or out of its range.
    #[error("{place}: {field} is {found}, expected {expected}")]
    Value {
        /// Which part of the scene, with its name: `primitive 3 (table top)`, `sun`, `sky`, `trajectory`.
        place: String,
        /// Which field of it.
        field: &'static str,
        /// The number given.
        found: f64,
        /// What is allowed there.
        expected: &'static str,
    },
    /// A view without samples, or with more than are of use.
    #[error("samples per pixel are {found}, expected 1 to 4096")]
    Samples {
        /// The number given.
        found: u32,
    },
    /// A camera, image or view that gs-scene refuses.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// The result of what can fail in this crate.
pub type Result<T> = std::result::Result<T, Error>;
