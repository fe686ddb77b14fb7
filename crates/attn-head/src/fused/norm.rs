//! Layer normalisation of rows of [`WIDTH`].

use super::sums::{Place, Sums};
use crate::{Layout, WIDTH};
use cpu_kernels::{Isa, LayerNorm};

/// What keeps a constant row finite, as in PyTorch.
const EPSILON: f32 = 1e-5;

/// Scale and shift of a normalisation.
#[derive(Debug)]
pub(super) struct Norm<'a> {
    isa: Isa,
    norm: LayerNorm<'a>,
    weight_at: Place,
    bias_at: Place,
}

impl<'a> Norm<'a> {
    pub(super) fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let (weight_at, bias_at) = Place::pair(layout, name);
        let (weight, bias) = (weight_at.of(values), bias_at.of(values));
        Self { isa, norm: LayerNorm { weight, bias, epsilon: EPSILON }, weight_at, bias_at }
    }

    /// Normalises rows.
    pub(super) fn apply(&self, x: &[f32], out: &mut [f32]) {
        self.norm.apply(self.isa, x, out);
    }

    /// Adds to `grad_x` and to the parameters' gradients what follows from the gradient of the output.
    pub(super) fn backward(&self, x: &[f32], grad_out: &[f32], grad_x: &mut [f32], sums: &mut Sums<'_>) {
        let (mut weight, mut bias) = ([0.0; WIDTH], [0.0; WIDTH]);
        self.norm.backward(self.isa, x, grad_out, grad_x, (&mut weight, &mut bias));
        sums.add(self.weight_at, &weight);
        sums.add(self.bias_at, &bias);
    }
}
