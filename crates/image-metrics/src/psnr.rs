use crate::Result;
use crate::check::{finite, same_size};
use gs_scene::Image;
use rayon::prelude::*;

/// Peak signal-to-noise ratio in decibels: -10 log₁₀ of the mean squared difference over pixels and channels, both
/// pictures clipped to 0..1. Equal pictures give +∞.
///
/// # Errors
/// If the sizes differ or a value is not finite.
pub fn psnr(a: &Image, b: &Image) -> Result<f64> {
    same_size(a, b)?;
    psnr_rgb(a.data(), b.data(), a.width(), a.height())
}

/// [`psnr`] of values `[height, width, 3]`.
///
/// # Errors
/// If there is no pixel, a length does not fit the size, or a value is not finite.
pub fn psnr_rgb(a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64> {
    finite("first", a, width, height, 1)?;
    finite("second", b, width, height, 1)?;
    let row = width * 3;
    let squares = |(a, b): (&[f32], &[f32])| -> f64 {
        let clip = |value: f32| f64::from(value.clamp(0.0, 1.0));
        a.iter().zip(b).map(|(&a, &b)| (clip(a) - clip(b)).powi(2)).sum()
    };
    // Rows are summed in their order, so that the result does not depend on the number of threads.
    let rows: Vec<f64> = a.par_chunks(row).zip(b.par_chunks(row)).map(squares).collect();
    let mean = rows.iter().sum::<f64>() / a.len() as f64;
    Ok(-10.0 * mean.log10())
}
