//! From the network's outputs to a surface: each pixel's inverse depth is a weighted mean of what the nine pixels about it at half the
//! size say and of what stereo found there.

use super::grid::Grid;
use super::inputs::Inputs;

/// Candidates of a pixel: the nine about it, and stereo's own.
const CANDIDATES: usize = 10;
/// Pixels of the full size in one of half the size.
const PIXELS: usize = 4;
/// Where the logits of the candidates' weights begin among the outputs; before them is the correction.
const LOGITS: usize = 1;
/// Where the logarithms of the errors to be expected begin.
const ERRORS: usize = LOGITS + PIXELS * CANDIDATES;
/// The logit of sky.
const SKY: usize = ERRORS + PIXELS;
/// Channels of the outputs.
pub(crate) const OUTPUTS: usize = SKY + 1;

/// Correction of a surface by an output of 1, plane steps.
const STEPS: f32 = 4.0;
/// Limits of the logarithm of the error to be expected.
const LOG_ERROR: (f32, f32) = (-3.0, 4.0);
/// Biases of the outputs at the beginning of training: stereo is nearly kept, and sky is rare.
const OWN_LOGIT: f32 = 4.0;
const SKY_LOGIT: f32 = -3.0;

/// What the network says of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoded {
    /// Inverse depth, relative to stereo's, plane steps `[height, width]`.
    pub correction: Vec<f32>,
    /// Natural logarithm of the mean absolute error that it expects, plane steps `[height, width]`.
    pub log_error: Vec<f32>,
    /// Logit of there being no surface, `[ceil(height / 2), ceil(width / 2)]`.
    pub sky: Vec<f32>,
}

/// An error below this many plane steps makes a depth as good as confirmed: as near as two views must be to agree.
const GOOD: f32 = 1.5;

impl Decoded {
    /// Probability that a pixel's error is small, of an error that has Laplace's distribution; 0 where there is no surface.
    #[must_use]
    pub fn confidence(&self, width: usize) -> Vec<f32> {
        let probability = |(pixel, log_error): (usize, &f32)| {
            if self.is_sky(pixel, width) { 0.0 } else { 1.0 - (-GOOD * (-log_error).exp()).exp() }
        };
        self.log_error.iter().enumerate().map(probability).collect()
    }

    /// Whether there is more likely no surface than one, at a pixel of rows of `width`.
    #[must_use]
    pub fn is_sky(&self, pixel: usize, width: usize) -> bool {
        self.sky[pixel / width / 2 * width.div_ceil(2) + pixel % width / 2] > 0.0
    }
}

/// Values of the last bias at the beginning of training.
pub(crate) fn initial_bias(output: usize) -> f32 {
    match output {
        SKY => SKY_LOGIT,
        LOGITS..ERRORS if (output - LOGITS) % CANDIDATES == CANDIDATES - 1 => OWN_LOGIT,
        _ => 0.0,
    }
}

/// One pixel's weights and candidates, in plane steps relative to `base` of its half-size pixel.
struct Mean {
    weights: [f32; CANDIDATES],
    candidates: [f32; CANDIDATES],
    value: f32,
}

/// The half-size pixels about (x, y), those beyond the border being the nearest inside.
fn neighbours(x: usize, y: usize, (width, height): (usize, usize)) -> [usize; 9] {
    std::array::from_fn(|k| {
        let coordinate = |i: usize, by: usize, n: usize| (i + by).saturating_sub(1).min(n - 1);
        coordinate(y, k / 3, height) * width + coordinate(x, k % 3, width)
    })
}

/// Surface of the half-size pixels, plane steps from the far end.
fn surface(inputs: &Inputs, outputs: &Grid) -> Vec<f32> {
    let (width, height) = (outputs.width, outputs.height);
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            out.push(inputs.base[y * width + x] + STEPS * outputs.pixel(x, y)[0]);
        }
    }
    out
}

/// Calls with every full-size pixel: its index, its half-size pixel, its number in that, and its mean.
fn for_pixels(
    inputs: &Inputs,
    outputs: &Grid,
    mut each: impl FnMut(usize, usize, usize, &[usize; 9], &Mean),
) {
    let half = (outputs.width, outputs.height);
    let surface = surface(inputs, outputs);
    for y in 0..half.1 {
        for x in 0..half.0 {
            let block = y * half.0 + x;
            let pixel = outputs.pixel(x, y);
            let about = neighbours(x, y, half);
            let mut candidates = [0.0; CANDIDATES];
            for (candidate, &from) in candidates.iter_mut().zip(&about) {
                *candidate = surface[from];
            }
            for part in 0..PIXELS {
                let (u, v) = (2 * x + part % 2, 2 * y + part / 2);
                if u >= inputs.width || v >= inputs.height {
                    continue;
                }
                let index = v * inputs.width + u;
                candidates[CANDIDATES - 1] = inputs.own[index];
                let logits = &pixel[LOGITS + part * CANDIDATES..][..CANDIDATES];
                let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                let mut weights = [0.0; CANDIDATES];
                let mut sum = 0.0;
                for (weight, logit) in weights.iter_mut().zip(logits) {
                    *weight = (logit - largest).exp();
                    sum += *weight;
                }
                let mut value = 0.0;
                for (weight, candidate) in weights.iter_mut().zip(&candidates) {
                    *weight /= sum;
                    value += *weight * candidate;
                }
                each(index, block, part, &about, &Mean { weights, candidates, value });
            }
        }
    }
}

/// What the outputs mean.
pub(crate) fn decode(inputs: &Inputs, outputs: &Grid) -> Decoded {
    let n = inputs.width * inputs.height;
    let (mut correction, mut log_error) = (vec![0.0; n], vec![0.0; n]);
    for_pixels(inputs, outputs, |index, block, part, _, mean| {
        correction[index] = mean.value - inputs.own[index];
        let raw = outputs.pixel(block % outputs.width, block / outputs.width)[ERRORS + part];
        log_error[index] = raw.clamp(LOG_ERROR.0, LOG_ERROR.1);
    });
    let sky = |i: usize| outputs.pixel(i % outputs.width, i / outputs.width)[SKY];
    Decoded { correction, log_error, sky: (0..outputs.width * outputs.height).map(sky).collect() }
}

/// The gradient of the outputs, from that of what they mean.
pub(crate) fn decode_backward(inputs: &Inputs, outputs: &Grid, gradient: &Decoded) -> Grid {
    let mut out = outputs.like(OUTPUTS);
    for_pixels(inputs, outputs, |index, block, part, about, mean| {
        let (x, y) = (block % outputs.width, block / outputs.width);
        let of_value = gradient.correction[index];
        for (k, &from) in about.iter().enumerate() {
            out.pixel_mut(from % outputs.width, from / outputs.width)[0] +=
                of_value * mean.weights[k] * STEPS;
        }
        let pixel = out.pixel_mut(x, y);
        for k in 0..CANDIDATES {
            pixel[LOGITS + part * CANDIDATES + k] =
                of_value * mean.weights[k] * (mean.candidates[k] - mean.value);
        }
        let raw = outputs.pixel(x, y)[ERRORS + part];
        if (LOG_ERROR.0..LOG_ERROR.1).contains(&raw) {
            pixel[ERRORS + part] = gradient.log_error[index];
        }
    });
    for (i, sky) in gradient.sky.iter().enumerate() {
        out.pixel_mut(i % outputs.width, i / outputs.width)[SKY] = *sky;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(i: usize) -> f32 {
        ((i as f32 * 12.9898).sin() * 43_758.547).fract()
    }

    /// A view of odd size, so that blocks are cut at the border.
    fn example() -> (Inputs, Grid) {
        let (width, height) = (5, 3);
        let steps = (0..15).map(|i| 20.0 + 3.0 * noise(i)).collect();
        let base = (0..6).map(|i| 20.0 + 3.0 * noise(100 + i)).collect();
        let mut outputs = Grid::new(3, 2, OUTPUTS);
        for i in 0..6 {
            for (c, value) in outputs.pixel_mut(i % 3, i / 3).iter_mut().enumerate() {
                *value = noise(1000 + i * OUTPUTS + c);
            }
        }
        let grid = Grid::new(3, 2, 1);
        (Inputs { width, height, grid, base, own: steps, unit: [0.1, 0.01] }, outputs)
    }

    #[test]
    fn means_stay_among_their_candidates_and_a_large_logit_keeps_stereo() {
        let (inputs, mut outputs) = example();
        let all: Vec<f32> = surface(&inputs, &outputs).into_iter().chain(inputs.own.clone()).collect();
        let (least, most) = all.iter().fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
        for (i, correction) in decode(&inputs, &outputs).correction.iter().enumerate() {
            assert!((least - 1e-3..=most + 1e-3).contains(&(inputs.own[i] + correction)));
        }
        for i in 0..6 {
            for part in 0..PIXELS {
                outputs.pixel_mut(i % 3, i / 3)[LOGITS + part * CANDIDATES + 9] = 40.0;
            }
        }
        assert!(decode(&inputs, &outputs).correction.iter().all(|c| c.abs() < 1e-4));
    }

    #[test]
    fn gradients_equal_finite_differences() {
        let (inputs, outputs) = example();
        let direction = Decoded {
            correction: (0..15).map(|i| noise(300 + i)).collect(),
            log_error: (0..15).map(|i| noise(400 + i)).collect(),
            sky: (0..6).map(|i| noise(500 + i)).collect(),
        };
        let dot =
            |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let loss = |outputs: &Grid| {
            let found = decode(&inputs, outputs);
            dot(&found.correction, &direction.correction)
                + dot(&found.log_error, &direction.log_error)
                + dot(&found.sky, &direction.sky)
        };
        let gradient = decode_backward(&inputs, &outputs, &direction);
        for i in 0..6 {
            for c in 0..OUTPUTS {
                let moved = |by: f32| {
                    let mut outputs = outputs.clone();
                    outputs.pixel_mut(i % 3, i / 3)[c] += by;
                    loss(&outputs)
                };
                let found = (moved(0.01) - moved(-0.01)) / 0.02;
                let expected = f64::from(gradient.pixel(i % 3, i / 3)[c]);
                assert!((found - expected).abs() < 2e-3, "pixel {i}, output {c}: {found} {expected}");
            }
        }
    }
}
