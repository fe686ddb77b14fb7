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
    /// A budget of nothing.
    #[error("budget is 0 Gaussians, expected at least 1")]
    EmptyBudget,
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
