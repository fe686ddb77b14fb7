#[cfg(target_arch = "x86_64")]
mod avx2;
mod band;
mod filter;
mod index;
mod reference;
mod target;
mod vector;

pub use target::{SsimScratch, SsimTarget};

use crate::Result;
use crate::check::{finite, same_size};
use gs_scene::Image;
use reference::Reference;

/// Side of the window of [`ssim`], pixels; smaller pictures have no structural similarity.
pub const SSIM_WINDOW: usize = 11;
/// Standard deviation of the Gaussian window, pixels (Wang et al. 2004, section III.C).
const SIGMA: f64 = 1.5;

/// Structural similarity (Wang et al. 2004) as scikit-image computes it with `gaussian_weights=True, win_size=11,
/// data_range=1` and default settings otherwise: Gaussian window of 11 × 11 and σ = 1.5, sample covariance, mean over the
/// channels and over the pixels whose window lies inside the picture. Equal pictures give 1.
///
/// Values are taken as they are; a caller who measures renderings clips them first. Computed in f64.
///
/// # Errors
/// If the sizes differ, a side is below [`SSIM_WINDOW`], or a value is not finite.
pub fn ssim(a: &Image, b: &Image) -> Result<f64> {
    same_size(a, b)?;
    ssim_rgb(a.data(), b.data(), a.width(), a.height())
}

/// [`ssim`] of values `[height, width, 3]`.
///
/// # Errors
/// If a length does not fit the size, a side is below [`SSIM_WINDOW`], or a value is not finite.
pub fn ssim_rgb(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64> {
    finite("first", a, width, height, SSIM_WINDOW)?;
    finite("second", b, width, height, SSIM_WINDOW)?;
    Ok(1.0 - Reference::<f64>::new(b, width, height).loss(a))
}
