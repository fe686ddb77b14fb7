//! The distance of two pictures' features at one layer.

use super::maps::Maps;
use rayon::prelude::*;

/// Added to the norm of a pixel's features, as published.
const EPSILON: f64 = 1e-10;
/// Pixels of a partial sum.
const CHUNK: usize = 256;

/// Features over the norm of their pixel.
pub(super) fn normalized(features: &Maps) -> Vec<f32> {
    let channels = features.channels;
    let mut out = features.values.clone();
    out.par_chunks_mut(CHUNK * channels).for_each(|chunk| {
        for pixel in chunk.chunks_exact_mut(channels) {
            let scale = 1.0 / (norm(pixel) + EPSILON);
            pixel.iter_mut().for_each(|value| *value = (f64::from(*value) * scale) as f32);
        }
    });
    out
}

/// Mean over pixels of the weighted squared difference of normalized features. `target` is normalized.
pub(super) fn distance(features: &Maps, target: &[f32], weights: &[f32]) -> f64 {
    let size = CHUNK * features.channels;
    let chunks = features.values.par_chunks(size).zip(target.par_chunks(size));
    let sums: Vec<f64> = chunks
        .map(|(features, target)| {
            let pixels = features.chunks_exact(weights.len()).zip(target.chunks_exact(weights.len()));
            pixels.map(|(features, target)| pixel_distance(features, target, weights)).sum()
        })
        .collect();
    // In their order, whatever the number of threads.
    sums.iter().sum::<f64>() / (features.height * features.width) as f64
}

/// The gradient of [`distance`] by the features.
pub(super) fn gradient(features: &Maps, target: &[f32], weights: &[f32]) -> Vec<f32> {
    let channels = features.channels;
    let scale = 2.0 / (features.height * features.width) as f64;
    let mut out = vec![0.0; features.values.len()];
    let size = CHUNK * channels;
    let chunks = out.par_chunks_mut(size).zip(features.values.par_chunks(size)).zip(target.par_chunks(size));
    chunks.for_each(|((out, features), target)| {
        let pixels = features.chunks_exact(channels).zip(target.chunks_exact(channels));
        for (out, (features, target)) in out.chunks_exact_mut(channels).zip(pixels) {
            pixel_gradient(features, target, weights, scale, out);
        }
    });
    out
}

fn norm(pixel: &[f32]) -> f64 {
    pixel.iter().map(|&value| f64::from(value).powi(2)).sum::<f64>().sqrt()
}

fn pixel_distance(features: &[f32], target: &[f32], weights: &[f32]) -> f64 {
    let scale = 1.0 / (norm(features) + EPSILON);
    let terms = features.iter().zip(target).zip(weights);
    terms
        .map(|((&value, &target), &weight)| {
            f64::from(weight) * (f64::from(value) * scale - f64::from(target)).powi(2)
        })
        .sum()
}

/// With r the norm, s = r + eps, n = f / s and g the gradient by n: g / s - f (g · f) / (s² r).
fn pixel_gradient(features: &[f32], target: &[f32], weights: &[f32], scale: f64, out: &mut [f32]) {
    let r = norm(features);
    if r == 0.0 {
        // All of the pixel's features were cut off by their ReLU, whose gradient is zero.
        return;
    }
    let s = r + EPSILON;
    let by_normalized =
        |c: usize| scale * f64::from(weights[c]) * (f64::from(features[c]) / s - f64::from(target[c]));
    let dot: f64 = (0..features.len()).map(|c| by_normalized(c) * f64::from(features[c])).sum();
    let along = dot / (s * s * r);
    for (c, out) in out.iter_mut().enumerate() {
        *out = (by_normalized(c) / s - f64::from(features[c]) * along) as f32;
    }
}
