//! Convolutions followed by ReLU, and their gradients by the input: windows copied to the rows of matrix products.

use super::maps::{Maps, View};
use candle_core::{Device, Tensor};
use rayon::prelude::*;

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
}

/// A convolution with its bias.
#[derive(Debug)]
pub(super) struct Convolution {
    window: Window,
    inputs: usize,
    outputs: usize,
    /// `[side · side · inputs, outputs]`.
    forward: Tensor,
    /// With stride 1 the weights of the convolution that takes gradients back, `[side · side · outputs, inputs]`; else
    /// `[outputs, side · side · inputs]`.
    backward: Tensor,
    bias: Vec<f32>,
}

impl Convolution {
    /// From weights `[outputs, inputs, side, side]`.
    pub(super) fn new(window: Window, inputs: usize, weight: &[f32], bias: Vec<f32>) -> Self {
        let (side, outputs) = (window.side, bias.len());
        let size = side * side;
        assert_eq!(weight.len(), outputs * inputs * size, "weights are [outputs, inputs, side, side]");
        let value = |o: usize, i: usize, place: usize| weight[(o * inputs + i) * size + place];
        let forward = matrix(size * inputs, outputs, |row, o| value(o, row % inputs, row / inputs));
        let backward = if window.stride == 1 {
            matrix(size * outputs, inputs, |row, i| value(row % outputs, i, size - 1 - row / outputs))
        } else {
            matrix(outputs, size * inputs, |o, column| value(o, column % inputs, column / inputs))
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
        let Window { side, stride, padding } = self.window;
        if stride == 1 {
            // A full correlation with the weights turned by half a turn.
            let window = Window { side, stride: 1, padding: side - 1 - padding };
            convolve(gradient, window, &self.backward, &mut out, 0, |_| ());
            return out;
        }
        let pixels = gradient.height * gradient.width;
        let mut rows = Vec::with_capacity(pixels * self.outputs);
        for pixel in 0..pixels {
            rows.extend_from_slice(gradient.pixel(pixel % gradient.width, pixel / gradient.width));
        }
        let windows = multiply(rows, self.outputs, &self.backward);
        // Windows overlap: they are added in their order.
        for (pixel, values) in windows.chunks_exact(side * side * self.inputs).enumerate() {
            let (x, y) = (pixel % gradient.width, pixel / gradient.width);
            for (place, values) in values.chunks_exact(self.inputs).enumerate() {
                let at = |step: usize, offset: usize| (step * stride + offset).checked_sub(padding);
                let (Some(x), Some(y)) = (at(x, place % side), at(y, place / side)) else { continue };
                if x < width && y < height {
                    let pixel = &mut out.values[(y * width + x) * self.inputs..][..self.inputs];
                    pixel.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
                }
            }
        }
        out
    }
}

/// Products of all windows of `x` with `weights`, into channels `first..` of `y`, each row finished by `finish`.
fn convolve(
    x: View<'_>,
    window: Window,
    weights: &Tensor,
    y: &mut Maps,
    first: usize,
    finish: impl Fn(&mut [f32]) + Sync,
) {
    let depth = window.side * window.side * x.channels;
    // A fixed number of pixels at a time, which bounds the memory of their windows.
    let strip = ((1 << 20) / depth).clamp(256, 2048);
    let (width, channels) = (y.width, y.channels);
    y.values.par_chunks_mut(strip * channels).enumerate().for_each(|(s, y)| {
        let pixels = y.len() / channels;
        let mut rows = vec![0.0; pixels * depth];
        for (i, row) in rows.chunks_exact_mut(depth).enumerate() {
            let pixel = s * strip + i;
            copy_window(x, window, pixel % width, pixel / width, row);
        }
        let products = multiply(rows, depth, weights);
        let outputs = products.len() / pixels;
        for (pixel, products) in y.chunks_exact_mut(channels).zip(products.chunks_exact(outputs)) {
            let pixel = &mut pixel[first..first + outputs];
            pixel.copy_from_slice(products);
            finish(pixel);
        }
    });
}

/// What the window of output pixel (x, y) sees, `[side, side, channels]`; `out` is zero where it sees nothing.
fn copy_window(maps: View<'_>, window: Window, x: usize, y: usize, out: &mut [f32]) {
    let at = |step: usize, offset: usize, n: usize| {
        (step * window.stride + offset).checked_sub(window.padding).filter(|&at| at < n)
    };
    for (place, out) in out.chunks_exact_mut(maps.channels).enumerate() {
        let source = (at(x, place % window.side, maps.width), at(y, place / window.side, maps.height));
        if let (Some(x), Some(y)) = source {
            out.copy_from_slice(maps.pixel(x, y));
        }
    }
}

fn matrix(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> Tensor {
    let values: Vec<f32> = (0..rows * columns).map(|i| value(i / columns, i % columns)).collect();
    Tensor::from_vec(values, (rows, columns), &Device::Cpu).expect("as many values as rows times columns")
}

/// Rows of `depth` values times a matrix `[depth, columns]`.
fn multiply(rows: Vec<f32>, depth: usize, matrix: &Tensor) -> Vec<f32> {
    let count = rows.len() / depth;
    let product = Tensor::from_vec(rows, (count, depth), &Device::Cpu).and_then(|rows| rows.matmul(matrix));
    let values = product.and_then(|product| product.flatten_all()?.to_vec1());
    values.expect("rows as long as the matrix is deep")
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
            (height, width) in (5_usize..24, 5_usize..24),
            (inputs, outputs) in (1_usize..5, 1_usize..7),
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
                            (row * window.stride + v).checked_sub(window.padding).filter(|&at| at < height),
                            (column * window.stride + u).checked_sub(window.padding).filter(|&at| at < width),
                        ) else { continue };
                        for i in 0..inputs {
                            let weight = f64::from(weight[((o * inputs + i) * window.side + v) * window.side + u]);
                            let at = (v0 * width + u0) * inputs + i;
                            sum += weight * f64::from(x.values[at]);
                            expected[at] += weight * f64::from(g.values[(row * w + column) * (outputs + 1) + 1 + o]);
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
