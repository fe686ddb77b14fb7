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

/// [`psnr`] of `image` after the gain and bias per channel that bring it closest to `target` (least squares, before the result is
/// clipped): what is left when exposure and white balance are no error. For finding out what is wrong: it is fitted to the target.
///
/// # Errors
/// If the sizes differ or a value is not finite.
pub fn psnr_colour_corrected(target: &Image, image: &Image) -> Result<f64> {
    same_size(target, image)?;
    finite("first", target.data(), target.width(), target.height(), 1)?;
    finite("second", image.data(), image.width(), image.height(), 1)?;
    let samples = |picture: &Image, channel: usize| -> Vec<f64> {
        let values = picture.data()[channel..].iter().step_by(3);
        values.map(|value| f64::from(value.clamp(0.0, 1.0))).collect()
    };
    let mut squares = 0.0;
    let pixels = (target.data().len() / 3) as f64;
    for channel in 0..3 {
        let (wanted, found) = (samples(target, channel), samples(image, channel));
        let mean = |values: &[f64]| values.iter().sum::<f64>() / pixels;
        let (centre, from) = (mean(&wanted), mean(&found));
        let product = |(a, b): (&f64, &f64)| (a - centre) * (b - from);
        let covariance: f64 = wanted.iter().zip(&found).map(product).sum();
        let variance: f64 = found.iter().map(|b| (b - from).powi(2)).sum();
        // A flat channel has no gain: its bias is all there is to choose.
        let gain = if variance > 0.0 { covariance / variance } else { 0.0 };
        let corrected = found.iter().map(|b| (centre + gain * (b - from)).clamp(0.0, 1.0));
        squares += wanted.iter().zip(corrected).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    }
    Ok(-10.0 * (squares / (3.0 * pixels)).log10())
}

/// Share of the squared error that lies in the worst `part` of the pixels, 0..1, both pictures clipped to 0..1: near 1 where a few
/// surfaces are wrong, near `part` where everything is off alike. 0 for equal pictures.
///
/// # Errors
/// If the sizes differ or a value is not finite.
///
/// # Panics
/// If `part` is not in 0..=1.
pub fn error_share(a: &Image, b: &Image, part: f64) -> Result<f64> {
    assert!((0.0..=1.0).contains(&part), "a part of {part}");
    same_size(a, b)?;
    finite("first", a.data(), a.width(), a.height(), 1)?;
    finite("second", b.data(), b.width(), b.height(), 1)?;
    let clip = |value: f32| f64::from(value.clamp(0.0, 1.0));
    let square = |(a, b): (&[f32], &[f32])| -> f64 {
        a.iter().zip(b).map(|(&a, &b)| (clip(a) - clip(b)).powi(2)).sum()
    };
    let mut squares: Vec<f64> = a.data().chunks(3).zip(b.data().chunks(3)).map(square).collect();
    squares.sort_unstable_by(|a, b| b.total_cmp(a));
    let worst = (part * squares.len() as f64).round() as usize;
    let (of_worst, all): (f64, f64) = (squares[..worst].iter().sum(), squares.iter().sum());
    Ok(if all > 0.0 { of_worst / all } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_and_bias_of_each_channel_are_no_error_after_correction() {
        let picture = |f: &dyn Fn(usize, usize) -> f32| {
            Image::new(8, 8, (0..192).map(|i| f(i / 3, i % 3)).collect()).unwrap()
        };
        let truth = picture(&|pixel, channel| 0.1 + 0.01 * pixel as f32 + 0.05 * channel as f32);
        let other = picture(&|pixel, channel| {
            let value = 0.1 + 0.01 * pixel as f32 + 0.05 * channel as f32;
            value * (0.5 + 0.2 * channel as f32) + 0.03
        });
        assert!(psnr(&truth, &other).unwrap() < 30.0);
        assert!(psnr_colour_corrected(&truth, &other).unwrap() > 100.0);
        // It cannot make one worse, and a flat picture becomes the mean.
        let noisy = picture(&|pixel, channel| ((pixel * 7 + channel * 3) % 11) as f32 / 11.0);
        assert!(psnr_colour_corrected(&truth, &noisy).unwrap() >= psnr(&truth, &noisy).unwrap());
        let flat = Image::filled(8, 8, [0.9; 3]).unwrap();
        let mean = picture(&|_, channel| 0.1 + 0.01 * 31.5 + 0.05 * channel as f32);
        let (found, expected) = (psnr_colour_corrected(&truth, &flat).unwrap(), psnr(&truth, &mean).unwrap());
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        assert!(psnr_colour_corrected(&truth, &Image::filled(8, 7, [0.9; 3]).unwrap()).is_err());
    }

    #[test]
    fn the_share_of_the_worst_is_that_of_errors_that_are_known() {
        let black = Image::filled(10, 10, [0.0; 3]).unwrap();
        assert_eq!(error_share(&black, &black, 0.1).unwrap(), 0.0);
        let alike = Image::filled(10, 10, [0.5; 3]).unwrap();
        assert!((error_share(&black, &alike, 0.1).unwrap() - 0.1).abs() < 1e-12);
        // Ten pixels beyond white, which count as white, ninety of a third: 10 of 10 + 90 / 9.
        let mut values = vec![1.0f32 / 3.0; 300];
        values[120..150].fill(7.0);
        let mixed = Image::new(10, 10, values).unwrap();
        assert!((error_share(&black, &mixed, 0.1).unwrap() - 0.5).abs() < 1e-6);
        assert_eq!(error_share(&mixed, &black, 1.0).unwrap(), 1.0);
        assert_eq!(error_share(&mixed, &black, 0.0).unwrap(), 0.0);
        let small = Image::filled(9, 10, [0.0; 3]).unwrap();
        assert!(error_share(&black, &small, 0.1).is_err());
    }
}
