//! Inference and gradients of the geo-aware attention head on the CPU, without a row of features for every pair.
//!
//! Anchor i with query q looks at j with key k_j and value v_j, by head c of width 32:
//!
//! ```text
//! h_ij     = ReLU(W1 (p_j - p_i) + b1)                         [128], for all heads
//! d_ij     = W2 h_ij + b2                                      [128], 32 for each head
//! logit_cj = (q - k_j + d_ij)[c] . q[c] / sqrt(32)
//! o[c]     = sum over j of alpha_cj (v_j + d_ij)[c],           alpha_c = softmax of logit_c
//! ```
//!
//! Softmax ignores terms that all logits of an anchor share, |q|² and b2 . q, and its weights add up to 1. So W2 is applied
//! to anchors instead of pairs, on both sides of the softmax:
//!
//! ```text
//! u_c      = W2[c]ᵀ q[c] / sqrt(32)                            [128]
//! logit_cj = u_c . h_ij - k_j[c] . q[c] / sqrt(32)             up to a number that is the same for all j
//! g_c      = sum over j of alpha_cj h_ij                       [128]
//! o[c]     = W2[c] g_c + b2[c] + sum over j of alpha_cj v_j[c]
//! ```
//!
//! A pair costs 3 x 128 products for h_ij, which is recomputed where it is needed, and 4 x 128 for each of u and g.
//! Everything else is a product of matrices over blocks of anchors.
//!
//! The gradient follows the same path backwards from the features before every layer. Each anchor gathers the gradients of its key and value
//! from the anchors that it is a neighbour of, in their order; gradients of weights are summed
//! over fixed ranges of anchors, then over ranges. Neither depends on the number of threads.
//!
//! Memory beyond inputs and outputs: for inference 3 buffers of `[n, 128]` numbers (features, keys, values) and some
//! 0.5 MB for each thread; for gradients 9 such buffers, 8 numbers and an index for every pair, and for each of up to
//! 32 ranges the gradients of one layer's weights, 27 MB in all.

mod backward;
mod layer;
mod linear;
mod network;
mod norm;
#[cfg(feature = "candle")]
mod op;
mod pairs;
mod perceptron;
mod sums;
mod transpose;

use crate::{Config, Inputs, LAYERS, Layout, OUTPUTS};
use backward::Backward;
use network::{BLOCK, Network};

#[cfg(feature = "candle")]
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
