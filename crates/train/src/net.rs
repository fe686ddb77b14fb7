//! A head as an operation of candle: weights and inputs to outputs.

use crate::Result;
use attn_head::Config;
use attn_head::fused::{self, Neighbourhood};
use candle_core::{Device, Tensor};
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

    /// Outputs `[n, 38]`, differentiable by `weights`, the numbers of all tensors one after the other: in a `VarMap` the tensors would
    /// have no order, and the length of their gradient would depend on it.
    pub(crate) fn outputs(&self, weights: &Tensor, inputs: HeadInputs) -> Result<Tensor> {
        let tensor = |values: Vec<f32>, width| Tensor::from_vec(values, (inputs.n, width), &Device::Cpu);
        let geometry = tensor(inputs.geometry, self.config.geometry)?;
        let image = tensor(inputs.image, self.config.image)?;
        let neighbourhood = Neighbourhood {
            k: inputs.k,
            neighbours: inputs.neighbours.into(),
            relative: inputs.relative.into(),
            cells: inputs.cells.into(),
        };
        Ok(fused::apply(&self.config, weights, &geometry, &image, &neighbourhood)?)
    }
}
