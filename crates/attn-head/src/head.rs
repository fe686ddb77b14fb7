#[cfg(feature = "candle")]
use crate::plain::{Network, TensorInputs};
use crate::{Config, Error, Inputs, Kind, OUTPUTS, Result, Weights, fused};
#[cfg(feature = "candle")]
use candle_core::{DType, Device};

/// Anchors whose pairs are in memory at a time: at K = 20 and f32 some 20 MB per map.
#[cfg(feature = "candle")]
const CHUNK: usize = 2048;

/// What computes the outputs.
#[derive(Debug)]
enum Form {
    /// [`fused`], the attention's own.
    Fused,
    /// The form on candle, in chunks.
    #[cfg(feature = "candle")]
    Plain(Network),
}

/// A head on the CPU: slices in, slices out.
#[derive(Debug)]
pub struct Head {
    weights: Weights,
    form: Form,
}

impl Head {
    /// A head with the given weights.
    ///
    /// # Errors
    /// If they do not fit their configuration or are not finite ([`Weights::check`]), or this build does not run their kind
    /// ([`Kind::BUILT`]).
    pub fn new(weights: Weights) -> Result<Self> {
        weights.check()?;
        let form = match weights.config.kind {
            Kind::Attention => Form::Fused,
            #[cfg(feature = "candle")]
            Kind::Mlp | Kind::EdgeConv | Kind::MaxPool => {
                let values = weights.to_tensor(DType::F32, &Device::Cpu)?;
                Form::Plain(Network::new(weights.config, &values)?)
            }
            #[cfg(not(feature = "candle"))]
            kind => return Err(Error::NotBuilt { kind }),
        };
        Ok(Self { weights, form })
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
    /// Memory beyond inputs and outputs is some `[n, 128]` buffers, and a bound that does not depend on n.
    ///
    /// # Errors
    /// Those of [`Inputs::check`]; and if finite inputs are so extreme that the outputs are not.
    pub fn run(&self, inputs: &Inputs<'_>) -> Result<Vec<f32>> {
        let out = match &self.form {
            Form::Fused => {
                inputs.check(self.config())?;
                fused::forward(self.config(), &self.weights.values, inputs)
            }
            #[cfg(feature = "candle")]
            Form::Plain(network) => {
                let tensors = TensorInputs::new(self.config(), inputs, DType::F32, &Device::Cpu)?;
                network.trace_in_chunks(&tensors, CHUNK)?.out.flatten_all()?.to_vec1()?
            }
        };
        match out.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(Error::OutputNotFinite { anchor: at / OUTPUTS }),
            None => Ok(out),
        }
    }
}
