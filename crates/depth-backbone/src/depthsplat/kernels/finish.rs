//! What follows the sums of a layer, while they are in the cache: bias, activation, scale, residual.

use super::math::{Activation, activate};
use multiversion::multiversion;

/// y = residual + scale · activation(x + bias), per channel; what is absent is left out.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Finish<'a> {
    /// `[channels]`.
    pub(in crate::depthsplat) bias: Option<&'a [f32]>,
    pub(in crate::depthsplat) activation: Activation,
    /// `[channels]`.
    pub(in crate::depthsplat) scale: Option<&'a [f32]>,
    /// As large as the whole output.
    pub(in crate::depthsplat) residual: Option<&'a [f32]>,
}

impl Finish<'_> {
    /// Finishes rows of `channels` values that start at value `offset` of the output.
    pub(super) fn apply(&self, values: &mut [f32], channels: usize, offset: usize) {
        if let Some(bias) = self.bias {
            values.chunks_exact_mut(channels).for_each(|row| add(row, bias));
        }
        activate(self.activation, values);
        if let Some(scale) = self.scale {
            values.chunks_exact_mut(channels).for_each(|row| multiply(row, scale));
        }
        if let Some(residual) = self.residual {
            add(values, &residual[offset..][..values.len()]);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn add(values: &mut [f32], other: &[f32]) {
    values.iter_mut().zip(other).for_each(|(v, o)| *v += o);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn multiply(values: &mut [f32], other: &[f32]) {
    values.iter_mut().zip(other).for_each(|(v, o)| *v *= o);
}
