//! Linear layers on rows.

use super::gemm::{Packed, Repacked, Rows, multiply, multiply_transposed};
use super::sums::{Place, Sums};
use crate::Layout;
use std::sync::OnceLock;

/// y = W x + b.
#[derive(Debug)]
pub(super) struct Linear<'a> {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    weight: &'a [f32],
    bias: &'a [f32],
    weight_at: Place,
    bias_at: Place,
    /// Wᵀ, which rows are multiplied with.
    forward: Packed,
    /// W, for the gradient; packed when first asked for.
    backward: OnceLock<Packed>,
}

impl<'a> Linear<'a> {
    pub(super) fn new(layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let (weight_at, bias_at) = Place::pair(layout, name);
        let (weight, bias) = (weight_at.of(values), bias_at.of(values));
        let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
        let forward = Packed::transposed(Rows::new(weight, outputs, inputs));
        let backward = OnceLock::new();
        Self { inputs, outputs, weight, bias, weight_at, bias_at, forward, backward }
    }

    /// Rows of `inputs` to the first columns of rows `stride` apart.
    pub(super) fn apply(&self, x: Rows<'_>, out: &mut [f32], stride: usize) {
        for row in out.chunks_mut(stride) {
            row[..self.outputs].copy_from_slice(self.bias);
        }
        multiply(x, &self.forward, out, stride);
    }

    /// Adds the layer's output to rows of `outputs`.
    pub(super) fn add(&self, x: Rows<'_>, out: &mut [f32]) {
        for row in out.chunks_exact_mut(self.outputs) {
            row.iter_mut().zip(self.bias).for_each(|(v, b)| *v += b);
        }
        multiply(x, &self.forward, out, self.outputs);
    }

    /// Adds Wᵀ times the gradient of the output to the input's.
    pub(super) fn input_gradient(&self, grad_out: Rows<'_>, grad_x: &mut [f32]) {
        let backward =
            self.backward.get_or_init(|| Packed::rows(Rows::new(self.weight, self.outputs, self.inputs)));
        multiply(grad_out, backward, grad_x, self.inputs);
    }

    /// Adds to the parameters' gradients.
    pub(super) fn weight_gradient(
        &self,
        x: Rows<'_>,
        grad_out: Rows<'_>,
        sums: &mut Sums<'_>,
        scratch: &mut Repacked,
    ) {
        multiply_transposed(grad_out, x, sums.at(self.weight_at), scratch);
        add_rows(grad_out, sums.at(self.bias_at));
    }
}

/// Adds the sum of rows to `sum`.
pub(super) fn add_rows(rows: Rows<'_>, sum: &mut [f32]) {
    for row in rows.iter() {
        sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += v);
    }
}
