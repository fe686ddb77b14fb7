//! Layers of which the heads are made, from operations that candle can differentiate exactly.

use crate::{Config, Layout, Result};
use candle_core::{D, Tensor};
use std::collections::HashMap;

/// Added to the variance in LayerNorm, as PyTorch does by default.
const EPSILON: f64 = 1e-5;

/// All parameters by name.
#[derive(Debug)]
pub(super) struct Parameters(HashMap<String, Tensor>);

impl Parameters {
    /// Views of a tensor `[len]`: gradients arrive there.
    pub(super) fn new(config: &Config, values: &Tensor) -> Result<Self> {
        let views = Layout::new(config).parameters.into_iter().map(|p| {
            let view = values.narrow(0, p.offset, p.len())?.reshape(p.shape)?;
            Ok((p.name, view))
        });
        Ok(Self(views.collect::<Result<_>>()?))
    }

    /// A parameter that the layout has.
    pub(super) fn get(&self, name: &str) -> &Tensor {
        &self.0[name]
    }

    /// Whether the layout has a parameter.
    pub(super) fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// A linear layer on the last dimension.
    pub(super) fn linear(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let y = project(x, self.get(&format!("{name}.weight")))?;
        Ok(y.broadcast_add(self.get(&format!("{name}.bias")))?)
    }

    /// LayerNorm over the last dimension.
    pub(super) fn norm(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let centred = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
        let normal = centred.broadcast_div(&(variance + EPSILON)?.sqrt()?)?;
        let scaled = normal.broadcast_mul(self.get(&format!("{name}.weight")))?;
        Ok(scaled.broadcast_add(self.get(&format!("{name}.bias")))?)
    }

    /// Two linear layers, `name.0` and `name.2`, and a ReLU between them.
    pub(super) fn relu_mlp(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        self.linear(&format!("{name}.2"), &self.linear(&format!("{name}.0"), x)?.relu()?)
    }

    /// Two linear layers, `name.0` and `name.2`, and a GELU between them.
    pub(super) fn gelu_mlp(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        self.linear(&format!("{name}.2"), &gelu(&self.linear(&format!("{name}.0"), x)?)?)
    }
}

/// x W^T on the last dimension; W is `[outputs, inputs]`.
pub(super) fn project(x: &Tensor, weight: &Tensor) -> Result<Tensor> {
    let (outputs, inputs) = weight.dims2()?;
    let mut shape = x.dims().to_vec();
    let rows = x.reshape(((), inputs))?;
    if let Some(last) = shape.last_mut() {
        *last = outputs;
    }
    Ok(rows.matmul(&weight.t()?)?.reshape(shape)?)
}

/// x Phi(x). Candle's own has a gradient with a constant of six digits only; that of its erf is exact.
fn gelu(x: &Tensor) -> Result<Tensor> {
    let twice_phi = ((x * std::f64::consts::FRAC_1_SQRT_2)?.erf()? + 1.0)?;
    Ok((x * 0.5)?.mul(&twice_phi)?)
}

/// Softmax over dimension 1 of `[n, seen, heads]`.
pub(super) fn softmax(logits: &Tensor) -> Result<Tensor> {
    // The shift has no influence on the result, so none on the gradient.
    let exp = logits.broadcast_sub(&logits.max_keepdim(1)?.detach())?.exp()?;
    Ok(exp.broadcast_div(&exp.sum_keepdim(1)?)?)
}

/// Maximum over dimension 1 of `[n, seen, width]`. Where several are equal, as for duplicate neighbours, the gradient
/// goes to the first; that of candle's own maximum would go to each.
pub(super) fn max(x: &Tensor) -> Result<Tensor> {
    Ok(x.gather(&x.argmax_keepdim(1)?.contiguous()?, 1)?.squeeze(1)?)
}
