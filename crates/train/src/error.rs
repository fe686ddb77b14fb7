use std::path::PathBuf;
use tensor_files::KeptFault;

/// Why a head was not trained.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting is out of its range.
    #[error("{setting}: {found}, expected {expected}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// What was given.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// Nothing to train on.
    #[error("no windows to train on")]
    NoWindows,
    /// A window has no views to compare with.
    #[error("{window}: no held-out views to compare with")]
    NoTargets {
        /// Its name.
        window: String,
    },
    /// A photograph without the depth that is to be learned.
    #[error("{window}: {view} has no measured depth, and depth is learned from measured depth")]
    NoMeasuredDepth {
        /// The window.
        window: String,
        /// Name of the photograph.
        view: String,
    },
    /// A file of the cache cannot be used.
    #[error("{}: this file of the cache cannot be used: remove it, it is made again", path.display())]
    CacheFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        #[source]
        source: KeptFault,
    },
    /// A checkpoint cannot be used. Nothing makes it again.
    #[error(
        "{}: the run cannot be resumed from this checkpoint: put a copy of it in its place, or begin anew in another folder; weights beside \
         it, if there are some, are a start",
        path.display()
    )]
    Checkpoint {
        /// The checkpoint.
        path: PathBuf,
        /// What is wrong.
        #[source]
        source: KeptFault,
    },
    /// A checkpoint is of another run.
    #[error("{}: the checkpoint's {what} differs from this run's: resume with the same, or begin anew in another folder", path.display())]
    OtherRun {
        /// The checkpoint.
        path: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// Weights to begin with that are of another head.
    #[error("{weights}: weights of {found}, expected {expected}")]
    OtherHead {
        /// What the weights are called.
        weights: String,
        /// The head that is to be trained.
        expected: String,
        /// The head that the weights are of.
        found: String,
    },
    /// Ranks that would have nothing to do.
    #[error("{ranks} ranks for a batch of {batch}: start at most {batch} ranks, or set a larger batch")]
    IdleRanks {
        /// Number of ranks.
        ranks: usize,
        /// Windows per step.
        batch: usize,
    },
    /// The ranks have begun different runs.
    #[error(
        "the ranks differ in settings, data, device or checkpoint: all need the same arguments and program, and folders that they share"
    )]
    RanksDiffer,
    /// MPI cannot be started twice in a process.
    #[cfg(feature = "mpi")]
    #[error("MPI was started in this process before")]
    MpiAlreadyStarted,
    /// Windows cannot be loaded.
    #[error(transparent)]
    Windows(Box<scene_windows::Error>),
    /// The pipeline before the head fails.
    #[error(transparent)]
    Predict(#[from] sparsesplat::Error),
    /// Weights of the learned depth that cannot be used.
    #[error(transparent)]
    Depth(#[from] depth_backbone::Error),
    /// A noun has the wrong shape.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A head refuses.
    #[error(transparent)]
    Head(#[from] attn_head::Error),
    /// The chain of operations fails.
    #[error(transparent)]
    Chain(#[from] candle_core::Error),
    /// The renderer fails.
    #[error(transparent)]
    Render(#[from] gs_raster::Error),
    /// Pictures cannot be compared.
    #[error("{view}: cannot be compared")]
    Metric {
        /// The photograph.
        view: String,
        /// Why.
        source: image_metrics::Error,
    },
}

/// This crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl From<scene_windows::Error> for Error {
    fn from(error: scene_windows::Error) -> Self {
        Self::Windows(Box::new(error))
    }
}
