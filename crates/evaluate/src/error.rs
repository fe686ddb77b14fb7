/// Why a window could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A window cannot be loaded, or its geometry cannot be cached.
    #[error(transparent)]
    Window(#[from] scene_windows::Error),
    /// The pipeline.
    #[error(transparent)]
    Predict(#[from] sparsesplat::Error),
    /// The renderer.
    #[error(transparent)]
    Render(#[from] gs_raster::Error),
    /// Refinement.
    #[error("the scene cannot be refined")]
    Refine(#[source] refine::Error),
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
}

/// This crate's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;
