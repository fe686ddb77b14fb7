//! The layers of the network on tensors with the channels last: `[view, row, column, channel]` or `[.., token, channel]`.
//! On the CPU they call [`super::kernels`]; elsewhere, and as the oracle of the tests, they are those of
//! candle-nn.

mod convolution;
mod linear;
mod norm;
mod shape;
mod slice;

pub(super) use convolution::{Conv, ConvTranspose};
pub(super) use linear::{AttentionShape, Linear, Part, attention};
pub(super) use norm::{GroupNorm, InstanceNorm, LayerNorm};
pub(super) use shape::{bilinear, join, nearest, relu, softmax, upscaled};
pub(super) use slice::{tensor, values};

use super::kernels::{Activation, Finish};
use candle_core::{Device, Result, Tensor};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What carries out the operations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Engine {
    /// Slices of the CPU's memory.
    Kernels,
    /// Candle's operations, on any device.
    Composed,
}

impl Engine {
    /// The fastest one for a device.
    pub(super) fn for_device(device: &Device) -> Self {
        if device.is_cpu() { Self::Kernels } else { Self::Composed }
    }
}

/// Floating-point operations of convolutions and matrix products so far, two per multiplication with addition, as if
/// done by the definition.
#[derive(Debug, Clone, Default)]
pub(super) struct Work(Arc<AtomicU64>);

impl Work {
    fn add(&self, rows: usize, depth: usize, columns: usize) {
        self.0.fetch_add(2 * (rows * depth * columns) as u64, Ordering::Relaxed);
    }

    pub(super) fn total(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What follows a layer's sums: y = residual + scale · activation(x).
#[derive(Debug, Clone, Copy)]
pub(super) struct Then<'a> {
    activation: Activation,
    scale: Option<&'a Tensor>,
    residual: Option<&'a Tensor>,
}

impl<'a> Then<'a> {
    pub(super) const NOTHING: Self = Self::activation(Activation::Identity);
    pub(super) const GELU: Self = Self::activation(Activation::Gelu);
    pub(super) const RELU: Self = Self::activation(Activation::Relu);

    const fn activation(activation: Activation) -> Self {
        Self { activation, scale: None, residual: None }
    }

    /// The sum with `residual`.
    pub(super) fn plus(residual: &'a Tensor) -> Self {
        Self { residual: Some(residual), ..Self::NOTHING }
    }

    /// Multiplied by `scale` per channel before the sum.
    pub(super) fn times(self, scale: &'a Tensor) -> Self {
        Self { scale: Some(scale), ..self }
    }

    /// Of candle's operations.
    fn compose(&self, y: Tensor) -> Result<Tensor> {
        let mut y = compose_activation(self.activation, y)?;
        if let Some(scale) = self.scale {
            y = y.broadcast_mul(scale)?;
        }
        match self.residual {
            Some(residual) => y + residual,
            None => Ok(y),
        }
    }

    /// Calls `f` with the same on slices.
    fn on_slices<T>(&self, bias: Option<&Tensor>, f: impl FnOnce(&Finish<'_>) -> T) -> Result<T> {
        let bias = bias.map(values).transpose()?;
        let scale = self.scale.map(values).transpose()?;
        let residual = self.residual.map(values).transpose()?;
        Ok(f(&Finish {
            bias: bias.as_deref(),
            activation: self.activation,
            scale: scale.as_deref(),
            residual: residual.as_deref(),
        }))
    }
}

fn compose_activation(activation: Activation, y: Tensor) -> Result<Tensor> {
    match activation {
        Activation::Identity => Ok(y),
        Activation::Relu => y.relu(),
        Activation::Gelu => y.gelu_erf(),
        Activation::Silu => y.silu(),
        Activation::Tanh => y.tanh(),
    }
}
