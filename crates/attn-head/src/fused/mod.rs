//! Inference and gradients of the geo-aware attention head on the CPU.

mod backward;
mod gemm;
mod layer;
mod linear;
mod math;
mod network;
mod norm;
mod op;
mod pairs;
mod perceptron;
mod sums;
mod transpose;

use crate::{Config, Inputs, LAYERS, Layout, OUTPUTS};
use backward::Backward;
use network::{BLOCK, Network};

pub use op::{Neighbourhood, apply};

/// Tasks that the anchors are divided into. Fixed, so that sums over them do not depend on the number of threads.
const RANGES: usize = 32;

/// Anchors of a task: whole blocks.
fn range_rows(n: usize) -> usize {
    n.div_ceil(BLOCK).div_ceil(RANGES).max(1) * BLOCK
}

/// Outputs `[n, 38]` of the head with `weights` as [`Layout`] orders them, for inputs that [`Inputs::check`] accepts.
///
/// # Panics
/// If the head is of another kind than attention, or there are too few or too many weights.
#[must_use]
pub fn forward(config: &Config, weights: &[f32], inputs: &Inputs<'_>) -> Vec<f32> {
    Network::new(config, &Layout::new(config), weights).run(config, inputs, |_| {})
}

/// What [`backward`] needs of a forward pass: the features before every layer and after the last,
/// 4 buffers of `[n, 128]`.
#[derive(Debug, Clone)]
pub struct Tape {
    features: Vec<Vec<f32>>,
}

/// As [`forward`], with what [`backward`] needs.
///
/// # Panics
/// As [`forward`].
#[must_use]
pub fn forward_recorded(config: &Config, weights: &[f32], inputs: &Inputs<'_>) -> (Vec<f32>, Tape) {
    let mut features = Vec::with_capacity(LAYERS + 1);
    let network = Network::new(config, &Layout::new(config), weights);
    let out = network.run(config, inputs, |x| features.push(x.to_vec()));
    (out, Tape { features })
}

/// Derivatives of a loss.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    /// By the weights, as [`Layout`] orders them.
    pub weights: Vec<f32>,
    /// By [`Inputs::geometry`].
    pub geometry: Vec<f32>,
    /// By [`Inputs::image`].
    pub image: Vec<f32>,
}

/// Gradients from those of the outputs `[n, 38]`; `tape` is that of the same weights and inputs.
///
/// # Panics
/// As [`forward`], or if `grad_out` or the tape is of another number of anchors.
#[must_use]
pub fn backward(
    config: &Config,
    weights: &[f32],
    inputs: &Inputs<'_>,
    tape: &Tape,
    grad_out: &[f32],
) -> Gradients {
    assert_eq!(grad_out.len(), inputs.n * OUTPUTS, "gradients of the outputs");
    let layout = &Layout::new(config);
    let network = &Network::new(config, layout, weights);
    Backward { config, layout, network, inputs }.run(tape, grad_out)
}
