//! Layer normalisation of rows of [`WIDTH`].

use super::sums::{Place, Sums};
use crate::{Layout, WIDTH};
use multiversion::multiversion;

/// What keeps a constant row finite, as in PyTorch.
const EPSILON: f64 = 1e-5;

/// Scale and shift of a normalisation.
#[derive(Debug)]
pub(super) struct Norm<'a> {
    weight: &'a [f32; WIDTH],
    bias: &'a [f32; WIDTH],
    weight_at: Place,
    bias_at: Place,
}

impl<'a> Norm<'a> {
    pub(super) fn new(layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let (weight_at, bias_at) = Place::pair(layout, name);
        let row = |at: Place| at.of(values).first_chunk().expect("the layout's shape of a normalisation");
        Self { weight: row(weight_at), bias: row(bias_at), weight_at, bias_at }
    }

    /// Normalises rows.
    pub(super) fn apply(&self, x: &[f32], out: &mut [f32]) {
        normalise(x, self.weight, self.bias, out);
    }

    /// Adds to `grad_x` and to the parameters' gradients what follows from the gradient of the output.
    pub(super) fn backward(&self, x: &[f32], grad_out: &[f32], grad_x: &mut [f32], sums: &mut Sums<'_>) {
        let [weight, bias] = normalise_backward(x, self.weight, grad_out, grad_x);
        sums.add(self.weight_at, &weight);
        sums.add(self.bias_at, &bias);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn normalise(x: &[f32], weight: &[f32; WIDTH], bias: &[f32; WIDTH], out: &mut [f32]) {
    for (x, out) in x.as_chunks().0.iter().zip(out.as_chunks_mut::<WIDTH>().0) {
        let (mean, scale) = statistics(x);
        for i in 0..WIDTH {
            out[i] = ((f64::from(x[i]) - mean) * scale) as f32 * weight[i] + bias[i];
        }
    }
}

/// Adds to `grad_x`; returns what is to be added to the gradients of scale and shift.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn normalise_backward(
    x: &[f32],
    scales: &[f32; WIDTH],
    grad_out: &[f32],
    grad_x: &mut [f32],
) -> [[f32; WIDTH]; 2] {
    let (mut weight, mut bias) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    let rows = x.as_chunks().0.iter().zip(grad_out.as_chunks::<WIDTH>().0);
    for ((x, grad_out), grad_x) in rows.zip(grad_x.as_chunks_mut::<WIDTH>().0) {
        let (mean, scale) = statistics(x);
        let normal: [f32; WIDTH] = std::array::from_fn(|i| ((f64::from(x[i]) - mean) * scale) as f32);
        let grad: [f32; WIDTH] = std::array::from_fn(|i| grad_out[i] * scales[i]);
        for i in 0..WIDTH {
            weight[i] += grad_out[i] * normal[i];
            bias[i] += grad_out[i];
        }
        let along_one = sum(|i| f64::from(grad[i])) / WIDTH as f64;
        let along_normal = sum(|i| f64::from(grad[i] * normal[i])) / WIDTH as f64;
        for i in 0..WIDTH {
            let across = f64::from(grad[i]) - along_one - f64::from(normal[i]) * along_normal;
            grad_x[i] += (across * scale) as f32;
        }
    }
    [weight, bias]
}

/// Mean and 1 / standard deviation, in f64: rows may be as large as f32 can hold, and their squares cannot.
#[inline(always)]
fn statistics(x: &[f32; WIDTH]) -> (f64, f64) {
    let mean = sum(|i| f64::from(x[i])) / WIDTH as f64;
    let variance = sum(|i| (f64::from(x[i]) - mean).powi(2)) / WIDTH as f64;
    (mean, 1.0 / (variance + EPSILON).sqrt())
}

/// Sum over a row, in lanes that become vector registers.
#[inline(always)]
fn sum(value: impl Fn(usize) -> f64) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0_f64; LANES];
    for i in (0..WIDTH).step_by(LANES) {
        for (l, lane) in lanes.iter_mut().enumerate() {
            *lane += value(i + l);
        }
    }
    lanes.iter().sum()
}
