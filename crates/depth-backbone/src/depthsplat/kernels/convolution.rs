//! Convolutions on slices, `[image, row, column, channel]`: windows copied to rows of a matrix product, strip by strip.

use super::finish::Finish;
use super::winograd::{self, Transformed};
use cpu_kernels::{Isa, Packed, Rows, multiply};
use rayon::prelude::*;

/// Values of a strip of windows: they stay in the second-level cache.
const STRIP: usize = 1 << 16;

/// Images as they lie: `[count, height, width, channels]`.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Maps<'a> {
    pub(in crate::depthsplat) values: &'a [f32],
    pub(in crate::depthsplat) height: usize,
    pub(in crate::depthsplat) width: usize,
    pub(in crate::depthsplat) channels: usize,
}

impl<'a> Maps<'a> {
    /// Values of one image.
    pub(super) fn size(&self) -> usize {
        self.height * self.width * self.channels
    }

    /// Number of images.
    pub(super) fn count(&self) -> usize {
        self.values.len() / self.size().max(1)
    }

    /// The values of a pixel.
    pub(super) fn pixel(&self, image: usize, y: usize, x: usize) -> &'a [f32] {
        &self.values[((image * self.height + y) * self.width + x) * self.channels..][..self.channels]
    }
}

/// What lies beyond the border.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::depthsplat) enum Border {
    /// Zeros.
    Zero,
    /// The nearest pixel.
    Replicate,
}

/// A square window and its steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::depthsplat) struct Window {
    pub(in crate::depthsplat) side: usize,
    pub(in crate::depthsplat) stride: usize,
    pub(in crate::depthsplat) padding: usize,
    pub(in crate::depthsplat) border: Border,
}

impl Window {
    /// Output size along an axis of `n` pixels.
    pub(in crate::depthsplat) fn steps(&self, n: usize) -> usize {
        (n + 2 * self.padding).saturating_sub(self.side) / self.stride + 1
    }

    /// The pixel, along an axis of `n`, that step `step` sees at place `place`.
    pub(super) fn source(&self, step: usize, place: usize, n: usize) -> Option<usize> {
        let padded = step * self.stride + place;
        let inside = padded.checked_sub(self.padding).filter(|&i| i < n);
        match self.border {
            Border::Zero => inside,
            Border::Replicate => Some(padded.saturating_sub(self.padding).min(n - 1)),
        }
    }
}

/// Weights in the form in which they are used.
#[derive(Debug, Clone)]
pub(in crate::depthsplat) enum Kernel {
    /// `[side · side · in, out]`.
    Windows(Packed),
    /// 3 x 3 windows of stride 1, transformed.
    Winograd(Transformed),
}

impl Kernel {
    /// From weights `[out, in, side, side]`.
    pub(in crate::depthsplat) fn new(weight: &[f32], outputs: usize, inputs: usize, window: Window) -> Self {
        let side = window.side;
        let value = |o: usize, i: usize, y: usize, x: usize| weight[((o * inputs + i) * side + y) * side + x];
        if (side, window.stride, window.padding) == (3, 1, 1) && winograd::suits(inputs, outputs) {
            return Self::Winograd(Transformed::new(inputs, outputs, value));
        }
        Self::Windows(Packed::new(Isa::in_use(), side * side * inputs, outputs, |k, o| {
            let (place, i) = (k / inputs, k % inputs);
            value(o, i, place / side, place % side)
        }))
    }

    fn outputs(&self) -> usize {
        match self {
            Self::Windows(packed) => packed.columns(),
            Self::Winograd(transformed) => transformed.outputs(),
        }
    }
}

/// The convolution of every image, `[count, steps(height), steps(width), out]`.
pub(in crate::depthsplat) fn convolve(
    x: Maps<'_>,
    window: Window,
    kernel: &Kernel,
    finish: &Finish<'_>,
) -> Vec<f32> {
    let (height, width) = (window.steps(x.height), window.steps(x.width));
    let mut y = vec![0.0; x.count() * height * width * kernel.outputs()];
    match kernel {
        Kernel::Winograd(transformed) => winograd::convolve(x, window, transformed, finish, &mut y),
        Kernel::Windows(packed) => by_windows(x, window, packed, finish, &mut y),
    }
    y
}

fn by_windows(x: Maps<'_>, window: Window, packed: &Packed, finish: &Finish<'_>, y: &mut [f32]) {
    let (height, width) = (window.steps(x.height), window.steps(x.width));
    let (depth, outputs) = (packed.depth(), packed.columns());
    let strip = (STRIP / depth).clamp(24, 96) / 24 * 24;
    y.par_chunks_mut(strip * outputs).enumerate().for_each_init(Vec::new, |scratch, (s, y)| {
        let (first, count) = (s * strip, y.len() / outputs);
        scratch.clear();
        for pixel in first..first + count {
            let (image, row, column) = (pixel / (height * width), pixel / width % height, pixel % width);
            copy_window(x, window, [image, row, column], scratch);
        }
        multiply(Rows::new(scratch, count, depth), packed, y, outputs, false);
        finish.apply(y, outputs, first * outputs);
    });
}

/// Appends what the window at (image, row, column) sees, `[side, side, channels]`.
fn copy_window(x: Maps<'_>, window: Window, [image, row, column]: [usize; 3], out: &mut Vec<f32>) {
    let first = (column * window.stride).checked_sub(window.padding);
    let whole = first.filter(|first| first + window.side <= x.width);
    for place in 0..window.side {
        match (window.source(row, place, x.height), whole) {
            (None, _) => out.resize(out.len() + window.side * x.channels, 0.0),
            (Some(y), Some(first)) => {
                let start = ((image * x.height + y) * x.width + first) * x.channels;
                out.extend_from_slice(&x.values[start..][..window.side * x.channels]);
            }
            (Some(y), None) => {
                for place in 0..window.side {
                    match window.source(column, place, x.width) {
                        Some(column) => out.extend_from_slice(x.pixel(image, y, column)),
                        None => out.resize(out.len() + x.channels, 0.0),
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cpu_kernels::Activation;
    use proptest::prelude::*;

    /// The definition, in f64.
    fn definition(x: Maps<'_>, window: Window, weight: &[f32], outputs: usize) -> Vec<f64> {
        let (height, width, side) = (window.steps(x.height), window.steps(x.width), window.side);
        let mut y = Vec::new();
        for image in 0..x.count() {
            for (row, column) in (0..height * width).map(|i| (i / width, i % width)) {
                for o in 0..outputs {
                    let mut sum = 0.0;
                    for (v, u) in (0..side * side).map(|i| (i / side, i % side)) {
                        let place = |step: usize, offset: usize, n: usize| {
                            let coordinate =
                                (step * window.stride + offset) as isize - window.padding as isize;
                            match window.border {
                                Border::Replicate => Some(coordinate.clamp(0, n as isize - 1) as usize),
                                Border::Zero => usize::try_from(coordinate).ok().filter(|&index| index < n),
                            }
                        };
                        if let (Some(v0), Some(u0)) = (place(row, v, x.height), place(column, u, x.width)) {
                            for (i, &value) in x.pixel(image, v0, u0).iter().enumerate() {
                                let w = weight[((o * x.channels + i) * side + v) * side + u];
                                sum += f64::from(value) * f64::from(w);
                            }
                        }
                    }
                    y.push(sum);
                }
            }
        }
        y
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn convolutions_agree_with_the_definition(
            (height, width, count) in (1_usize..14, 1_usize..14, 1_usize..3),
            channels in prop_oneof![1_usize..6, Just(8), Just(16), Just(24)],
            outputs in prop_oneof![1_usize..5, Just(16), Just(24)],
            shape in prop_oneof![Just((3, 1, 1)), Just((3, 2, 1)), Just((1, 1, 0)), Just((1, 2, 0)), Just((7, 2, 3))],
            replicate: bool,
            seed: u32,
        ) {
            let (side, stride, padding) = shape;
            let border = if replicate { Border::Replicate } else { Border::Zero };
            let window = Window { side, stride, padding, border };
            let value = |i: usize| {
                let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
                ((mixed ^ (mixed >> 15)) >> 8) as f32 / 8_388_608.0 - 1.0
            };
            let values: Vec<f32> = (0..count * height * width * channels).map(value).collect();
            let weight: Vec<f32> =
                (0..outputs * channels * side * side).map(|i| value(i + 999_983)).collect();
            let x = Maps { values: &values, height, width, channels };
            let expected = definition(x, window, &weight, outputs);
            let bias: Vec<f32> = (0..outputs).map(|i| value(i + 55_555)).collect();
            let residual: Vec<f32> = (0..expected.len()).map(|i| value(i + 123_457)).collect();
            let finish = Finish {
                bias: Some(&bias), activation: Activation::Relu, scale: Some(&bias), residual: Some(&residual),
            };
            let found = convolve(x, window, &Kernel::new(&weight, outputs, channels, window), &finish);
            prop_assert_eq!(found.len(), expected.len());
            for (i, (found, sum)) in found.iter().zip(&expected).enumerate() {
                let bias = f64::from(bias[i % outputs]);
                let expected = f64::from(residual[i]) + bias * (sum + bias).max(0.0);
                prop_assert!((f64::from(*found) - expected).abs() < 2e-4, "{}: {}, not {}", i, found, expected);
            }
        }
    }
}
