use std::path::PathBuf;

/// Why a window could not be measured or shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Reading the data set.
    #[error(transparent)]
    Data(#[from] view_data::Error),
    /// The pipeline.
    #[error(transparent)]
    Predict(#[from] sparsesplat::Error),
    /// The renderer.
    #[error(transparent)]
    Render(#[from] gs_raster::Error),
    /// Refinement.
    #[error("refinement: {0}")]
    Refine(#[source] refine::Error),
    /// Simulating a scene.
    #[error(transparent)]
    Simulate(#[from] scene_sim::Error),
    /// A file or a picture.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// Two pictures that cannot be compared.
    #[error("view {view} cannot be compared with its rendering or nearest view")]
    Metric {
        /// Name of the view.
        view: String,
        /// Why.
        #[source]
        source: image_metrics::Error,
    },
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
    /// Fewer pictures are there than views are asked for, because some are missing.
    #[error(
        "{}: {views} views asked for, but of {} frames {} have no picture (missing: {})",
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
    /// `--depth-range hint` on a data set that does not say.
    #[error(
        "{}: no scene_depth_percentiles, points or measured depth, one of which --depth-range hint needs",
        path.display()
    )]
    NoDepthHint {
        /// The data set.
        path: PathBuf,
    },
    /// A file of a cache of geometry is not what this code writes.
    #[error("{}: {problem}: remove the file, it can be made again", path.display())]
    CacheFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
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
