//! A head as an operation of candle: weights and inputs to outputs.

use crate::Result;
use attn_head::Config;
use candle_core::Tensor;
use sparsesplat::learned::HeadInputs;

pub(crate) struct Net {
    config: Config,
}

impl Net {
    pub(crate) fn new(config: Config) -> Self {
        Self { config }
    }

    pub(crate) fn config(&self) -> Config {
        self.config
    }

    /// Outputs `[n, 38]`, differentiable by `weights`, the numbers of all tensors one after the other.
    pub(crate) fn outputs(&self, weights: &Tensor, inputs: HeadInputs) -> Result<Tensor> {
        todo!()
    }
}
