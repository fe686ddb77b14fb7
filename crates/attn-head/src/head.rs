use crate::{Config, Error, Inputs, OUTPUTS, Result, Weights, fused};

/// A head on the CPU: slices in, slices out.
#[derive(Debug)]
pub struct Head {
    weights: Weights,
}

impl Head {
    /// A head with the given weights.
    ///
    /// # Errors
    /// If they do not fit their configuration or are not finite ([`Weights::check`]).
    pub fn new(weights: Weights) -> Result<Self> {
        weights.check()?;
        Ok(Self { weights })
    }

    /// Its weights.
    #[must_use]
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// Its shape.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.weights.config
    }

    /// The outputs, `[n, 38]`: opacity 1, scale 3, rotation 4, SH 27, offset 3. What they mean is up to the training.
    /// Memory beyond inputs and outputs is up to three `[n, 128]` buffers, and a bound that does not depend on n.
    ///
    /// # Errors
    /// Those of [`Inputs::check`]; and if finite inputs are so extreme that the outputs are not.
    pub fn run(&self, inputs: &Inputs<'_>) -> Result<Vec<f32>> {
        inputs.check(self.config())?;
        let out = fused::forward(self.config(), &self.weights.values, inputs);
        match out.iter().position(|v| !v.is_finite()) {
            Some(index) => Err(Error::OutputNotFinite { anchor: index / OUTPUTS }),
            None => Ok(out),
        }
    }
}
