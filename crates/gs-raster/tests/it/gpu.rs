//! The GPU path as a whole. These tests need an adapter, a software one will do, and fail where there is none.

mod batches;
mod determinism;
mod golden;
mod hostile;
mod limits;
mod random;

use gs_raster::gpu::{AdapterChoice, GpuOptions};
use gs_raster::{Gradients, Rasterizer, Rendering};
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

/// Any adapter, and NaN in every buffer before use.
pub(crate) const OPTIONS: GpuOptions =
    GpuOptions { adapter: AdapterChoice::OrSoftware, poison: true, largest_binding: None };

/// The GPU of these tests, which all share so that each finds the buffers that others left.
fn gpu() -> MutexGuard<'static, Rasterizer> {
    static GPU: LazyLock<Mutex<Rasterizer>> = LazyLock::new(|| Mutex::new(another_gpu()));
    GPU.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One that has rendered nothing yet but its self-test.
fn another_gpu() -> Rasterizer {
    Rasterizer::gpu(&OPTIONS).expect("an adapter")
}

/// Every bit of a rendering.
fn bits(view: &Rendering) -> Vec<u32> {
    let depth = view.depth.iter().flatten();
    view.image.data().iter().chain(&view.alpha).chain(depth).map(|value| value.to_bits()).collect()
}

/// Every bit of gradients.
fn gradient_bits(gradients: &Gradients) -> Vec<u64> {
    let poses = gradients.cameras.iter().flat_map(|pose| {
        let numbers = pose.rotation.to_cols_array().into_iter().chain(pose.translation.to_array());
        numbers.chain([pose.focal]).collect::<Vec<f64>>()
    });
    let doubles = gradients.background.into_iter().chain(poses).map(f64::to_bits);
    let singles = gradients.geometry.iter().chain(&gradients.sh).map(|value| u64::from(value.to_bits()));
    singles.chain(doubles).collect()
}
