/// Why depth could not be estimated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No views at all.
    #[error("no views given, expected at least one")]
    NoViews,
    /// Stereo from a single view.
    #[error("stereo needs at least two views, found one: give more views, or measured depth")]
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
    /// Depth was measured in no pixel of any view.
    #[error("the measured depth maps are empty")]
    NothingMeasured,
    /// All cameras stand in one place, or see nothing in common.
    #[error("the depth range cannot be estimated: {reason}; state it, or give views that overlap")]
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
    /// Other colours for features that cannot be computed from colours and depth alone.
    #[error("features \"{schema}\" are a network's, which would have to see the view in its other colours")]
    NetworkFeatures {
        /// What the features say that they are.
        schema: String,
    },
    /// Not one geometry for each view.
    #[error("{geometry} depth maps for {views} views, expected as many")]
    ViewCount {
        /// Number of views.
        views: usize,
        /// Number of their geometries.
        geometry: usize,
    },
    /// Depth or confidence of another size than the view.
    #[error("view {view}: depth is {}x{} or its confidence has another size, expected {}x{}", found.0, found.1, expected.0, expected.1)]
    GeometrySize {
        /// Name of the view.
        view: String,
        /// Width and height of the view.
        expected: (usize, usize),
        /// Width and height of the depth map.
        found: (usize, usize),
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
    /// Views of different sizes, for a network that takes them as one block.
    #[cfg(feature = "depthsplat")]
    #[error("view {view} is {}x{}, the first is {}x{}: the network needs views of one size", found.0, found.1, first.0, first.1)]
    SizesDiffer {
        /// Name of the view.
        view: String,
        /// Its width and height.
        found: (usize, usize),
        /// Those of the first view.
        first: (usize, usize),
    },
    /// The network's result is not a depth.
    #[cfg(feature = "depthsplat")]
    #[error(
        "view {view}: the network's depth at pixel ({x}, {y}) is not finite: its weights or the picture are extreme"
    )]
    DepthNotFinite {
        /// Name of the view.
        view: String,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// A Gaussian of the network's own head is none.
    #[cfg(feature = "depthsplat")]
    #[error(
        "view {view}: the network's Gaussian at pixel ({x}, {y}) is not finite: its weights or the picture are extreme"
    )]
    GaussianNotFinite {
        /// Name of the view.
        view: String,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// A file of weights cannot be read, or is none.
    #[cfg(feature = "depthsplat")]
    #[error("weights {path}: cannot be read as a PyTorch archive or safetensors", path = path.display())]
    WeightsUnreadable {
        /// The file.
        path: std::path::PathBuf,
        /// Why.
        source: candle_core::Error,
    },
    /// A file of weights is not the one that its name promises.
    #[cfg(feature = "depthsplat")]
    #[error("weights {path}: its SHA-256 starts with {found}, its name promises {expected}: fetch it again", path = path.display())]
    WeightsHash {
        /// The file.
        path: std::path::PathBuf,
        /// Eight hexadecimal digits at the end of its name.
        expected: String,
        /// The first eight of its hash.
        found: String,
    },
    /// A file holds tensors, but none of the networks.
    #[cfg(feature = "depthsplat")]
    #[error("weights {path}: its {found} tensors are none of DepthSplat's networks: their shapes tell by \
        `depth_predictor.pretrained.cls_token` and `depth_predictor.upsampler.concat_projects`", path = path.display())]
    WeightsUnknown {
        /// The file.
        path: std::path::PathBuf,
        /// Number of tensors.
        found: usize,
    },
    /// Tensors of a checkpoint are missing, unexpected, misshapen or not finite.
    #[cfg(feature = "depthsplat")]
    #[error("weights {path} do not fit {variant}: {}", tensor_files::first_few(problems), path = path.display())]
    Weights {
        /// The file.
        path: std::path::PathBuf,
        /// The network that its shapes tell.
        variant: crate::Variant,
        /// All that does not fit.
        problems: Vec<crate::WeightProblem>,
    },
    /// Features from weights that are for depth alone.
    #[cfg(feature = "depthsplat")]
    #[error(
        "the weights are for depth alone, and features or Gaussians are wanted: use a checkpoint with `feature_upsampler`"
    )]
    NoFeatureWeights,
    /// A file of weights of the learned depth stage that is none, or does not fit.
    #[error("weights {}", path.display())]
    DepthWeightsFile {
        /// The file.
        path: std::path::PathBuf,
        /// Why.
        source: Box<Error>,
    },
    /// Tensors of the learned depth stage are missing, unexpected, misshapen or not finite.
    #[error("the weights of the learned depth do not fit: {}", tensor_files::first_few(problems))]
    DepthWeights {
        /// All that does not fit.
        problems: Vec<tensor_files::WeightProblem>,
    },
    /// A safetensors file of something else.
    #[error("no weights of the learned depth: the metadata have no \"learned-depth\"")]
    NotDepthWeights,
    /// No safetensors.
    #[error(transparent)]
    Safetensors(#[from] tensor_files::SafetensorsFault),
    /// A file cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// Gaussians of a backbone that has no head of its own.
    #[error(
        "{backbone} has no head of its own that makes Gaussians: use DepthSplat's network, or another head"
    )]
    NoOwnHead {
        /// The backbone.
        backbone: &'static str,
    },
    /// An operation on tensors failed.
    #[cfg(feature = "depthsplat")]
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// A map does not fit its picture.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
