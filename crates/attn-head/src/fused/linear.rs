//! Linear layers on rows.

use super::sums::{Place, Sums};
use crate::Layout;
use cpu_kernels::{Isa, Packed, Rows, multiply, multiply_transposed, rows};
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
    pub(super) fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let (weight_at, bias_at) = Place::pair(layout, name);
        let (weight, bias) = (weight_at.of(values), bias_at.of(values));
        let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
        let forward = Packed::transposed(isa, Rows::new(weight, outputs, inputs));
        let backward = OnceLock::new();
        Self { inputs, outputs, weight, bias, weight_at, bias_at, forward, backward }
    }

    /// Rows of `inputs` to the first columns of rows `stride` apart.
    pub(super) fn apply(&self, x: Rows<'_>, out: &mut [f32], stride: usize) {
        for row in out.chunks_mut(stride) {
            row[..self.outputs].copy_from_slice(self.bias);
        }
        multiply(x, &self.forward, out, stride, true);
    }

    /// Adds the layer's output to rows of `outputs`.
    pub(super) fn add(&self, x: Rows<'_>, out: &mut [f32]) {
        rows::add_to_each(self.forward.isa(), out, self.bias);
        multiply(x, &self.forward, out, self.outputs, true);
    }

    /// Adds Wᵀ times the gradient of the output to the input's.
    pub(super) fn input_gradient(&self, grad_out: Rows<'_>, grad_x: &mut [f32]) {
        let weight = Rows::new(self.weight, self.outputs, self.inputs);
        let backward = self.backward.get_or_init(|| Packed::rows(self.forward.isa(), weight));
        multiply(grad_out, backward, grad_x, self.inputs, true);
    }

    /// Adds to the parameters' gradients.
    pub(super) fn weight_gradient(&self, x: Rows<'_>, grad_out: Rows<'_>, sums: &mut Sums<'_>) {
        let isa = self.forward.isa();
        multiply_transposed(isa, grad_out, x, sums.at(self.weight_at));
        rows::add_sum(isa, grad_out, sums.at(self.bias_at));
    }
}
