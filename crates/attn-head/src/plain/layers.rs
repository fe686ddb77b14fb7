//! Layers that candle-nn lacks, or has without exact derivatives.

use candle_core::{Result, Tensor};
use candle_nn::{Linear, Module, VarBuilder, linear, ops};

/// Added to the variance in LayerNorm, as PyTorch does by default.
const EPSILON: f32 = 1e-5;

/// Two linear layers, `0` and `2` as in a `Sequential` of PyTorch, with an activation between them.
#[derive(Debug)]
pub(super) struct Perceptron {
    first: Linear,
    activation: fn(&Tensor) -> Result<Tensor>,
    last: Linear,
}

impl Perceptron {
    pub(super) fn relu(widths: [usize; 3], vb: &VarBuilder<'_>) -> Result<Self> {
        Self::load(widths, Tensor::relu, vb)
    }

    pub(super) fn gelu(widths: [usize; 3], vb: &VarBuilder<'_>) -> Result<Self> {
        Self::load(widths, gelu, vb)
    }

    fn load(
        [inputs, hidden, outputs]: [usize; 3],
        activation: fn(&Tensor) -> Result<Tensor>,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        let first = linear(inputs, hidden, vb.pp(0))?;
        Ok(Self { first, activation, last: linear(hidden, outputs, vb.pp(2))? })
    }
}

impl Module for Perceptron {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.last.forward(&(self.activation)(&self.first.forward(x)?)?)
    }
}

/// LayerNorm over the last dimension. The module of candle-nn calls a kernel without derivatives.
#[derive(Debug)]
pub(super) struct Norm {
    weight: Tensor,
    bias: Tensor,
}

impl Norm {
    pub(super) fn load(width: usize, vb: &VarBuilder<'_>) -> Result<Self> {
        Ok(Self { weight: vb.get(width, "weight")?, bias: vb.get(width, "bias")? })
    }
}

impl Module for Norm {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        ops::layer_norm_slow(x, &self.weight, &self.bias, EPSILON)
    }
}

/// The part of a linear layer for `width` of its inputs, from input `first` on; the part for the first inputs has the bias. What
/// depends on one anchor is computed once in this way, and not for every pair that the anchor is in.
pub(super) fn part(whole: &Linear, first: usize, width: usize) -> Result<Linear> {
    let weight = whole.weight().narrow(1, first, width)?.contiguous()?;
    Ok(Linear::new(weight, whole.bias().filter(|_| first == 0).cloned()))
}

/// x Phi(x). The derivative of candle's own has a constant of six digits; that of its erf is exact.
fn gelu(x: &Tensor) -> Result<Tensor> {
    let twice_phi = ((x * std::f64::consts::FRAC_1_SQRT_2)?.erf()? + 1.0)?;
    (x * 0.5)? * twice_phi
}

/// Maximum over dimension 1 of `[n, seen, width]`. Where several are equal, as for duplicate neighbours, the gradient
/// goes to the first; that of candle's own maximum would go to each.
pub(super) fn max(x: &Tensor) -> Result<Tensor> {
    x.gather(&x.argmax_keepdim(1)?.contiguous()?, 1)?.squeeze(1)
}
