use std::path::PathBuf;
use tensor_files::KeptFault;

/// Why a window cannot be found, loaded or cached.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Reading the data set.
    #[error(transparent)]
    Data(#[from] view_data::Error),
    /// The backbone, whose result is cached.
    #[error(transparent)]
    Predict(#[from] sparsesplat::Error),
    /// Simulating a scene.
    #[error(transparent)]
    Simulate(#[from] scene_sim::Error),
    /// A file or a picture.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A window without context views.
    #[error("the window has no context views, expected at least one")]
    NoContext,
    /// Views cannot be selected by their overlap.
    #[error(
        "{}: {views} views asked for, but its {frames} frames tell no scale: photographs must be taken from more than \
         one place",
        path.display()
    )]
    OnePlace {
        /// The data set.
        path: PathBuf,
        /// Frames there are.
        frames: usize,
        /// Views asked for.
        views: usize,
    },
    /// Fewer pictures are there than views are asked for, because some are missing or broken.
    #[error(
        "{}: {views} views asked for, but of {} frames {} have no picture that can be read (missing or broken: {})",
        path.display(), present + missing.len(), missing.len(), missing.join(", ")
    )]
    TooFewPictures {
        /// The data set.
        path: PathBuf,
        /// Views asked for.
        views: usize,
        /// Frames with a picture.
        present: usize,
        /// Names of those without.
        missing: Vec<String>,
    },
    /// A window that the index does not have.
    #[error("{}: no window {key:?}, only: {known}", index.display())]
    NoWindow {
        /// The index file.
        index: PathBuf,
        /// What was asked for.
        key: String,
        /// The keys there are.
        known: String,
    },
    /// A window that is left out.
    #[error("{}: window {key:?} is left out: {reason}", index.display())]
    DroppedWindow {
        /// The index file.
        index: PathBuf,
        /// What was asked for.
        key: String,
        /// Why it is left out.
        reason: String,
    },
    /// The depth range of a data set is asked for that states none.
    #[error(
        "{}: the data set states no depth range: it has no scene_depth_percentiles, no points and no measured depth; have the range \
         estimated, or state it",
        path.display()
    )]
    NoDepthHint {
        /// The data set.
        path: PathBuf,
    },
    /// A file of a cache of geometry cannot be used.
    #[error("{}: this file of the cache cannot be used: remove it, it is made again", path.display())]
    CacheFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        #[source]
        source: KeptFault,
    },
}

/// This crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;
