/// Why there is no prediction.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No depth.
    #[error(transparent)]
    Backbone(#[from] depth_backbone::Error),
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
    /// A budget of nothing.
    #[error("budget is 0 Gaussians, expected at least 1")]
    EmptyBudget,
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
