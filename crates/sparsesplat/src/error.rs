/// Why there is no prediction.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No depth.
    #[error(transparent)]
    Backbone(#[from] depth_backbone::Error),
    /// Cameras in one place see no parallax.
    #[error(
        "all {views} views are taken from one place (at most {distance:.1e} scene units apart): stereo tells no depth there, whatever its \
         range; move the camera between photographs, or give measured depth"
    )]
    NoParallax {
        /// How many views.
        views: usize,
        /// Largest distance between two cameras, scene units.
        distance: f64,
    },
    /// A map or Gaussian that does not fit.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// No pixels to choose, or a setting of the sampler out of range.
    #[error(transparent)]
    Sampling(#[from] entropy_sampler::Error),
    /// Pixels that cannot be lifted.
    #[error(transparent)]
    Backproject(#[from] backproject::Error),
    /// Anchors without neighbours.
    #[error(transparent)]
    Knn(#[from] knn::Error),
    /// Anchors without neighbours by co-visibility.
    #[error(transparent)]
    Covisibility(#[from] covisibility::Error),
    /// Weights that cannot be read, or inputs that a head refuses.
    #[error(transparent)]
    Head(#[from] attn_head::Error),
    /// A closed form that cannot be rendered for the head's feedback, or a scene for the corrector's.
    #[error(
        "the scene cannot be rendered into {view} for the feedback of the learned head or the corrector (the closed-form head and no correction need none)"
    )]
    Feedback {
        /// Name of the view.
        view: String,
        /// What the renderer says.
        source: Box<gs_raster::Error>,
    },
    /// Gaussians that cannot be rendered for further looks.
    #[error(
        "the Gaussians cannot be rendered for further looks at the views (with one look the head's are the result)"
    )]
    Looks(#[source] Box<refine::Error>),
    /// A pass that looks at nothing.
    #[error("the number of looks is 0, expected at least 1: one look is the head alone")]
    NoLook,
    /// A factor of a probability that is none.
    #[error("the weight of {pixels} pixels is {found}, expected 0 to 1")]
    PixelWeight {
        /// Which pixels it is of.
        pixels: &'static str,
        /// What was given.
        found: f32,
    },
    /// The included attention with a backbone whose features it was not trained on.
    #[error(
        "the head attention was trained on the features of the plane sweep: take that backbone, or another head"
    )]
    AttentionBackbone,
    /// Weights without the name of the features that they were trained on.
    #[error("{weights}: does not say which features it was trained on: expected weights that `train` wrote")]
    NoSchema {
        /// The weights.
        weights: String,
    },
    /// Weights of another version of this crate.
    #[error(
        "{weights}: wants {found} geometric features per anchor, there are {without}, or {with} with feedback: train it anew (weights of a corrector are no head)"
    )]
    GeometryFeatures {
        /// The weights.
        weights: String,
        /// Features that there are without feedback.
        without: usize,
        /// Features that there are with feedback.
        with: usize,
        /// Features that the weights want.
        found: usize,
    },
    /// Weights of a head, not of a corrector.
    #[error(
        "{weights}: wants {found} geometric features per anchor, a corrector has {expected}: expected weights that `train` wrote with the setting `refined`"
    )]
    NotOfCorrector {
        /// The weights.
        weights: String,
        /// Features that a corrector has.
        expected: usize,
        /// Features that the weights want.
        found: usize,
    },
    /// Weights of a corrector that do not change what they see, or see other neighbours.
    #[error(
        "{weights}: the metadata say {key} {found:?}: a corrector has the parametrisation correction and no co-visible neighbours"
    )]
    CorrectorMetadata {
        /// The weights.
        weights: String,
        /// What is said.
        key: &'static str,
        /// Its value.
        found: String,
    },
    /// Weights that were trained on the features of another backbone.
    #[error(
        "{weights}: trained on features {expected:?}, the backbone gives {found:?}: use weights trained with it, or --head closed-form; of a corrector none"
    )]
    OtherFeatures {
        /// The weights.
        weights: String,
        /// Schema of the features that they were trained on.
        expected: String,
        /// Schema of the features that there are.
        found: String,
    },
    /// An unknown value in the metadata of weights.
    #[error(
        "{weights}: the metadata say {key} {found:?}, which this program does not know: it may be older than the weights"
    )]
    Metadata {
        /// The weights.
        weights: String,
        /// What is said.
        key: &'static str,
        /// As it is said.
        found: String,
    },
    /// A network is asked for of a build that has none.
    #[error("{weights}: this build has no networks: build with the feature `depthsplat`")]
    NoNetwork {
        /// Its weights.
        weights: String,
    },
    /// DepthSplat's head with anything but all pixels.
    #[error("DepthSplat's head makes a Gaussian of every pixel: use it with the allocation pixel-aligned")]
    OwnHeadAllocation,
    /// DepthSplat's head with surfaces that were joined after it.
    #[error("DepthSplat's head makes its Gaussians from the depth of its network: surfaces cannot be fused")]
    OwnHeadFusion,
    /// A corrector for Gaussians that have no anchors of their own.
    #[error(
        "a corrector changes the Gaussian of each anchor: merged Gaussians, and those of DepthSplat's head, have none"
    )]
    NothingToCorrect,
    /// Colours of a scene that no head can make.
    #[error("a corrector changes colours of SH degree 2 or less, the scene has {found}")]
    CorrectedColours {
        /// The degree.
        found: usize,
    },
    /// DepthSplat's head without the Gaussians that it made.
    #[error("DepthSplat's head is asked for, and the backbone's geometry comes without its Gaussians")]
    NoOwnGaussians,
    /// The factor of a probability as the budget of an allocation that draws no pixels but wants a count.
    #[error("budget is tau {tau}, but the allocation draws no pixels: expected a count of Gaussians")]
    NothingDrawn {
        /// The budget.
        tau: f64,
    },
    /// A budget of nothing.
    #[error("budget is 0 Gaussians, expected at least 1")]
    EmptyBudget,
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
