//! Convolutions followed by ReLU, and their gradients by the input: windows copied to the rows of matrix products, a strip of pixels
//! at a time.

use super::maps::{Maps, View};
use cpu_kernels::{Isa, Packed, Rows, multiply};
use rayon::prelude::*;
use std::ops::Range;

/// Values of the windows of a strip: 256 KiB, which stay in the second-level cache until they are multiplied.
const STRIP: usize = 1 << 16;
/// Rows of the picture whose gradient is added up together. The windows that reach across their border are computed twice.
const BAND: usize = 32;
/// Channels of the input from which on the gradient is a convolution, too. With fewer its products would mostly be of the zeros that
/// fill up a vector.
const WIDE: usize = 8;

/// A square window and its steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) side: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

impl Window {
    /// Output size along an axis of `n` pixels; none if the window does not fit.
    pub(super) fn steps(self, n: usize) -> Option<usize> {
        Some((n + 2 * self.padding).checked_sub(self.side)? / self.stride + 1)
    }

    /// The part of the window at `step` that lies within an axis of `n` pixels.
    fn within(self, step: usize, n: usize) -> Range<usize> {
        let start = step * self.stride;
        self.padding.saturating_sub(start)..(n + self.padding).saturating_sub(start).min(self.side)
    }

    /// Whether it sees one pixel, the output's own.
    fn is_pixel(self) -> bool {
        self == Self { side: 1, stride: 1, padding: 0 }
    }
}

/// A convolution with its bias.
#[derive(Debug)]
pub(super) struct Convolution {
    window: Window,
    inputs: usize,
    outputs: usize,
    /// `[side · side · inputs, outputs]`.
    forward: Packed,
    backward: Backward,
    bias: Vec<f32>,
}

/// Weights that take gradients back.
#[derive(Debug)]
enum Backward {
    /// Of a full correlation with the weights turned by half a turn, `[side · side · outputs, inputs]`.
    Convolution(Packed),
    /// From a pixel of the output to its window, `[outputs, side · side · inputs]`.
    Windows(Packed),
}

impl Convolution {
    /// From weights `[outputs, inputs, side, side]`.
    pub(super) fn new(window: Window, inputs: usize, weight: &[f32], bias: Vec<f32>) -> Self {
        let (side, outputs, isa) = (window.side, bias.len(), Isa::in_use());
        let size = side * side;
        assert_eq!(weight.len(), outputs * inputs * size, "weights are [outputs, inputs, side, side]");
        let value = |o: usize, i: usize, place: usize| weight[(o * inputs + i) * size + place];
        let forward = Packed::new(isa, size * inputs, outputs, |row, o| value(o, row % inputs, row / inputs));
        let backward = if window.stride == 1 && inputs >= WIDE {
            let turned = |row: usize, i| value(row % outputs, i, size - 1 - row / outputs);
            Backward::Convolution(Packed::new(isa, size * outputs, inputs, turned))
        } else {
            let by_output = |o, column: usize| value(o, column % inputs, column / inputs);
            Backward::Windows(Packed::new(isa, outputs, size * inputs, by_output))
        };
        Self { window, inputs, outputs, forward, backward, bias }
    }

    pub(super) fn outputs(&self) -> usize {
        self.outputs
    }

    /// ReLU of the convolution, into channels `first..` of `y`.
    pub(super) fn apply(&self, x: View<'_>, y: &mut Maps, first: usize) {
        convolve(x, self.window, &self.forward, y, first, |row| {
            for (value, bias) in row.iter_mut().zip(&self.bias) {
                *value = (*value + bias).max(0.0);
            }
        });
    }

    /// Output height and width.
    pub(super) fn size(&self, height: usize, width: usize) -> Option<(usize, usize)> {
        Some((self.window.steps(height)?, self.window.steps(width)?))
    }

    /// The gradient by the input, of `height` and `width`, from that by the convolution before its ReLU.
    pub(super) fn pull_back(&self, gradient: View<'_>, height: usize, width: usize) -> Maps {
        let mut out = Maps::zeros(height, width, self.inputs);
        match &self.backward {
            Backward::Convolution(weights) => {
                let Window { side, padding, .. } = self.window;
                let window = Window { side, stride: 1, padding: side - 1 - padding };
                convolve(gradient, window, weights, &mut out, 0, |_| ());
            }
            Backward::Windows(weights) => add_windows(gradient, self.window, weights, &mut out),
        }
        out
    }
}

/// Products of all windows of `x` with `weights`, into channels `first..` of `y`, each row finished by `finish`.
fn convolve(
    x: View<'_>,
    window: Window,
    weights: &Packed,
    y: &mut Maps,
    first: usize,
    finish: impl Fn(&mut [f32]) + Sync,
) {
    let depth = window.side * window.side * x.channels;
    // A fixed number of pixels at a time, whatever the number of threads.
    let strip = (STRIP / depth).clamp(48, 1024);
    let (width, channels) = (y.width, y.channels);
    let outputs = first..first + weights.columns();
    let strips = y.values.par_chunks_mut(strip * channels).enumerate();
    strips.for_each_init(Vec::new, |windows, (s, y)| {
        let pixels = s * strip..s * strip + y.len() / channels;
        let rows = if window.is_pixel() {
            x.rows().slice(pixels)
        } else {
            windows.resize(pixels.len() * depth, 0.0);
            for (pixel, row) in pixels.clone().zip(windows.chunks_exact_mut(depth)) {
                copy_window(x, window, pixel % width, pixel / width, row);
            }
            Rows::new(windows, pixels.len(), depth)
        };
        multiply(rows, weights, &mut y[first..], channels, false);
        y.chunks_exact_mut(channels).for_each(|pixel| finish(&mut pixel[outputs.clone()]));
    });
}

/// What the window of output pixel (x, y) sees, `[side, side, channels]`, zero where it sees nothing.
fn copy_window(maps: View<'_>, window: Window, x: usize, y: usize, out: &mut [f32]) {
    let (columns, rows) = (window.within(x, maps.width), window.within(y, maps.height));
    let (left, right) = (columns.start * maps.channels, columns.end * maps.channels);
    for (v, out) in out.chunks_exact_mut(window.side * maps.channels).enumerate() {
        if rows.contains(&v) {
            out[..left].fill(0.0);
            out[right..].fill(0.0);
            let [x, y] = [(x, columns.start), (y, v)]
                .map(|(step, offset)| step * window.stride + offset - window.padding);
            maps.copy(x, y, &mut out[left..right]);
        } else {
            out.fill(0.0);
        }
    }
}

/// Adds to `out` the window of every pixel of `gradient`, its product with `weights`.
fn add_windows(gradient: View<'_>, window: Window, weights: &Packed, out: &mut Maps) {
    let Window { side, stride, padding } = window;
    let (width, inputs, size) = (out.width, out.channels, weights.columns());
    out.values.par_chunks_mut(BAND * width * inputs).enumerate().for_each_init(
        Vec::new,
        |windows, (band, out)| {
            let above = band * BAND;
            let height = out.len() / (width * inputs);
            // Rows of the gradient whose windows reach these of `out`.
            let first = (above + padding + 1).saturating_sub(side).div_ceil(stride);
            let last = ((above + height - 1 + padding) / stride + 1).min(gradient.height);
            let pixels = first * gradient.width..last * gradient.width;
            windows.resize(pixels.len() * size, 0.0);
            multiply(gradient.rows().slice(pixels.clone()), weights, windows, size, false);
            // Windows overlap: they are added in their order.
            for (pixel, values) in pixels.zip(windows.chunks_exact(size)) {
                let (x, y) = (pixel % gradient.width, pixel / gradient.width);
                let columns = window.within(x, width);
                for (v, values) in values.chunks_exact(side * inputs).enumerate() {
                    let row = (y * stride + v).checked_sub(padding + above).filter(|&row| row < height);
                    let Some(row) = row else { continue };
                    let start = row * width + x * stride + columns.start - padding;
                    let sums = &mut out[start * inputs..][..columns.len() * inputs];
                    sums.iter_mut()
                        .zip(&values[columns.start * inputs..])
                        .for_each(|(sum, value)| *sum += value);
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value(i: usize, seed: u32) -> f32 {
        let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
        ((mixed ^ (mixed >> 15)) >> 8) as f32 / 8_388_608.0 - 1.0
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        /// Each product of a weight and a pixel, by the definition: forward, and back where the output is not cut.
        #[test]
        fn both_ways_agree_with_the_definition(
            (height, width) in (5_usize..40, 5_usize..24),
            (inputs, outputs) in (1_usize..12, 1_usize..7),
            shape in prop::sample::select(vec![(3, 1, 1), (1, 1, 0), (5, 1, 2), (3, 2, 0), (11, 4, 2)]),
            seed: u32,
        ) {
            let window = Window { side: shape.0, stride: shape.1, padding: shape.2 };
            prop_assume!(height + 2 * window.padding >= window.side && width + 2 * window.padding >= window.side);
            let x = Maps { values: (0..height * width * inputs).map(|i| value(i, seed)).collect(), height, width, channels: inputs };
            let weight: Vec<f32> = (0..outputs * inputs * window.side.pow(2)).map(|i| value(i + 7777, seed)).collect();
            let bias: Vec<f32> = (0..outputs).map(|i| value(i + 99_999, seed)).collect();
            let layer = Convolution::new(window, inputs, &weight, bias.clone());
            let (h, w) = layer.size(height, width).unwrap();
            let mut y = Maps::zeros(h, w, outputs + 2);
            layer.apply(x.view(), &mut y, 1);
            let g = Maps { values: (0..h * w * (outputs + 1)).map(|i| value(i + 5_555, seed)).collect(), height: h, width: w, channels: outputs + 1 };
            let back = layer.pull_back(g.part(1, outputs), height, width);

            let mut expected = vec![0.0_f64; height * width * inputs];
            for (row, column) in (0..h * w).map(|i| (i / w, i % w)) {
                for o in 0..outputs {
                    let mut sum = f64::from(bias[o]);
                    for (v, u) in (0..window.side.pow(2)).map(|i| (i / window.side, i % window.side)) {
                        let (Some(v0), Some(u0)) = (
                            (row * window.stride + v).checked_sub(window.padding).filter(|&index| index < height),
                            (column * window.stride + u).checked_sub(window.padding).filter(|&index| index < width),
                        ) else { continue };
                        for i in 0..inputs {
                            let weight = f64::from(weight[((o * inputs + i) * window.side + v) * window.side + u]);
                            let index = (v0 * width + u0) * inputs + i;
                            sum += weight * f64::from(x.values[index]);
                            expected[index] += weight * f64::from(g.values[(row * w + column) * (outputs + 1) + 1 + o]);
                        }
                    }
                    let found = y.values[(row * w + column) * (outputs + 2) + 1 + o];
                    prop_assert!((f64::from(found) - sum.max(0.0)).abs() < 1e-4, "{} for {}", found, sum);
                }
                prop_assert_eq!(y.values[(row * w + column) * (outputs + 2)], 0.0);
            }
            for (found, expected) in back.values.iter().zip(&expected) {
                prop_assert!((f64::from(*found) - expected).abs() < 1e-4, "{} for {}", found, expected);
            }
        }
    }
}
