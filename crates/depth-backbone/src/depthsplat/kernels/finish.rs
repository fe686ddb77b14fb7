//! What follows the sums of a layer, while they are in the cache: bias, activation, scale, residual.

use cpu_kernels::{Activation, Isa, rows};

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
        let isa = Isa::in_use();
        if let Some(bias) = self.bias {
            rows::add_to_each(isa, values, &bias[..channels]);
        }
        self.activation.apply(isa, values);
        if let Some(scale) = self.scale {
            rows::multiply_each(isa, values, &scale[..channels]);
        }
        if let Some(residual) = self.residual {
            rows::add(isa, values, &residual[offset..][..values.len()]);
        }
    }
}
