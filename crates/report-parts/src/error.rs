/// Why a picture cannot be encoded or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A picture that the encoder refuses.
    #[error("a picture of {width}x{height} cannot be encoded")]
    Encode {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Why.
        #[source]
        source: image::ImageError,
    },
}

/// This crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;
