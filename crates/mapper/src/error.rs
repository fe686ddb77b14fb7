use std::path::PathBuf;
use tensor_files::KeptFault;

/// Why a map cannot be made, or cannot go on. A frame that is only unusable is no error, but refused:
/// [`Refusal`](crate::Refusal).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting outside its range.
    #[error("setting {name} of the map is {found}, expected {expected}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        found: f64,
        /// Its range.
        expected: &'static str,
    },
    /// The forward pass of a keyframe failed.
    #[error("frame {frame}: no Gaussians can be made of it")]
    Predict {
        /// Name of the frame.
        frame: String,
        /// Why not.
        source: sparsesplat::Error,
    },
    /// The map cannot be rendered.
    #[error(transparent)]
    Raster(#[from] gs_raster::Error),
    /// The map cannot be refined.
    #[error(transparent)]
    Refine(#[from] refine::Error),
    /// Gaussians that cannot be merged.
    #[error(transparent)]
    Knn(#[from] knn::Error),
    /// A picture, camera or map that does not fit.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A snapshot that cannot be written or read.
    #[error("{}: snapshot of a map", path.display())]
    Snapshot {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: KeptFault,
    },
    /// A snapshot whose parts do not fit each other.
    #[error("{}: snapshot of a map: {what} is {found}, expected {expected}", path.display())]
    Inconsistent {
        /// The file.
        path: PathBuf,
        /// Which part.
        what: &'static str,
        /// Its value.
        found: usize,
        /// What the rest says.
        expected: usize,
    },
    /// A snapshot with settings that no mapper takes.
    #[error("{}: snapshot of a map", path.display())]
    SnapshotSettings {
        /// The file.
        path: PathBuf,
        /// Which setting.
        source: Box<Error>,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
