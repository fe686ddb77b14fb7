//! A small network behind the plane sweep. It sees what stereo knows of a view and where the other views' surfaces lie, and gives a
//! surface everywhere, the error to be expected of it, and where there is none.

mod decode;
mod grid;
mod inputs;
mod network;
mod weights;

pub use decode::Decoded;
pub(crate) use inputs::{Evidence, of_all};
pub use inputs::{InputParts, Inputs};
pub use weights::DepthWeights;

use crate::Result;
use cpu_kernels::Isa;
use decode::{OUTPUTS, decode, decode_backward};
use grid::Grid;
use inputs::INPUTS;
use network::{Architecture, Prepared};
use std::fmt;

/// The network with its weights, ready to run.
pub struct DepthNetwork {
    architecture: Architecture,
    prepared: Prepared,
    name: String,
}

impl fmt::Debug for DepthNetwork {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("DepthNetwork").field(&self.name).finish()
    }
}

/// What one pass of the network left behind, for its gradient.
pub struct Recorded {
    nodes: Vec<Grid>,
    /// What the outputs mean.
    pub decoded: Decoded,
}

impl DepthNetwork {
    /// For passes alone.
    ///
    /// # Errors
    /// If the weights are not those of the network, or not finite.
    pub fn new(weights: &DepthWeights) -> Result<Self> {
        Self::prepared(weights, false)
    }

    /// For gradients as well.
    ///
    /// # Errors
    /// As [`DepthNetwork::new`].
    pub fn for_training(weights: &DepthWeights) -> Result<Self> {
        Self::prepared(weights, true)
    }

    fn prepared(weights: &DepthWeights, gradients: bool) -> Result<Self> {
        weights.check()?;
        let architecture = Architecture::new(INPUTS, OUTPUTS);
        let prepared = Prepared::new(Isa::in_use(), &architecture, &weights.values, gradients);
        Ok(Self { architecture, prepared, name: weights.name() })
    }

    /// What tells these weights from others: the beginning of their hash.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What it says of a view.
    #[must_use]
    pub fn run(&self, inputs: &Inputs) -> Decoded {
        decode(inputs, &self.architecture.run(&self.prepared, inputs.grid.clone()))
    }

    /// What it says of a view, with what its gradient needs.
    #[must_use]
    pub fn record(&self, inputs: &Inputs) -> Recorded {
        let nodes = self.architecture.record(&self.prepared, inputs.grid.clone());
        let decoded = decode(inputs, &nodes[nodes.len() - 1]);
        Recorded { nodes, decoded }
    }

    /// The gradient of all weights, from that of what the outputs mean.
    ///
    /// # Panics
    /// If the network was not made [for training](Self::for_training).
    #[must_use]
    pub fn backward(&self, inputs: &Inputs, recorded: &Recorded, gradient: &Decoded) -> Vec<f32> {
        let outcome = decode_backward(inputs, &recorded.nodes[recorded.nodes.len() - 1], gradient);
        self.architecture.backward(&self.prepared, &recorded.nodes, outcome)
    }
}
