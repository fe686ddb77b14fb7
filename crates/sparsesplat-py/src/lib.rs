#![doc = include_str!("../README.md")]

mod arrays;
mod cameras;
mod engine;
mod failure;

mod kept;
mod lent;
mod rasterize;
mod settings;
mod tape;

mod scene;
mod view;

mod metrics;
mod reconstruct;

/// The compiled part of the Python package `sparsesplat`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::metrics::{entropy, knn, psnr, ssim};
    #[pymodule_export]
    use super::rasterize::{device, rasterize, record};
    #[pymodule_export]
    use super::reconstruct::{reconstruct, simulated_views};
    #[pymodule_export]
    use super::scene::{Scene, load_ply};
    #[pymodule_export]
    use super::tape::Tape;
    #[pymodule_export]
    use super::view::View;
}
