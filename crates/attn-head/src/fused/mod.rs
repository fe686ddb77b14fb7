//! Inference and gradients of the heads on the CPU, without a row of features for every pair.
//!
//! The kinds share all but the message that an anchor gets from its neighbours, see the modules `attention`, `maximum`
//! (edge convolution and max pooling), `mlp` and `grid`. What depends on one anchor alone is computed once for each. The
//! rows of pairs are made block by block, stay in the caches, and are made again for the gradient, as are the hidden values of the
//! perceptrons. The grid has no pairs, so there the hidden values are most of what would be made again, and are kept.
//!
//! The gradient goes backwards from the features before every layer. Each anchor gathers the gradient of what it shows from the
//! anchors that it is a neighbour of, in their order (in the grid, from the means over its cells); gradients of weights are summed
//! over fixed ranges of anchors, then over ranges. Neither depends on the number of threads.
//!
//! Memory beyond inputs and outputs, in buffers of `[n, 128]` numbers:
//!
//! | | inference | gradients, with the tape |
//! |---|---|---|
//! | attention | 3 | 9, and 8 numbers for every pair |
//! | edge convolution | 3 | 14, and 3 bytes for every pair |
//! | max pooling | 2 | 12, and 3 bytes for every pair |
//! | MLP | 1 | 5, and 16 numbers for every pair |
//! | grid | 2 | 9 |
//!
//! An index for every pair, some 1 MB for each thread, and for each of up to 32 ranges the gradients of one layer's
//! weights, 27 MB in all, come on top.

mod attention;
mod backward;
mod edge_conv;
mod grid;
mod layer;
mod linear;
mod max_pool;
mod maximum;
mod message;
mod mlp;
mod network;
mod norm;
#[cfg(feature = "candle")]
mod op;
mod perceptron;
mod sums;
mod transpose;

use crate::{Config, Inputs, Kind, Layout, OUTPUTS, WIDTH};
use attention::Attention;
use backward::Backward;
use edge_conv::EdgeConv;
use grid::Grid;
use max_pool::MaxPool;
use message::{Message, Record};
use mlp::Mlp;
use network::{BLOCK, Network};
use rayon::prelude::*;

#[cfg(feature = "candle")]
pub use op::{Neighbourhood, apply};

/// Tasks that the anchors are divided into. Fixed, so that sums over them do not depend on the number of threads.
const RANGES: usize = 32;

/// Zeros, which all threads write: one alone would take as long for a large buffer as a fortieth of a forward pass.
fn zeros(count: usize) -> Vec<f32> {
    let mut zeros = Vec::new();
    rayon::iter::repeat_n(0.0, count).with_min_len(1 << 16).collect_into_vec(&mut zeros);
    zeros
}

/// Anchors of a task: whole blocks.
fn range_rows(n: usize) -> usize {
    n.div_ceil(BLOCK).div_ceil(RANGES).max(1) * BLOCK
}

/// Outputs `[n, 38]` of the head with `weights` as [`Layout`] orders them, for inputs that [`Inputs::check`] accepts.
///
/// # Panics
/// If there are too few or too many weights.
#[must_use]
pub fn forward(config: &Config, weights: &[f32], inputs: &Inputs<'_>) -> Vec<f32> {
    outputs(config, weights, inputs, None)
}

/// What [`backward`] needs of a forward pass: the features before every layer and after the last, up to 4 buffers of
/// `[n, 128]`; of edge convolution and max pooling also the maxima, and which pair has each, 3 times 1.25 buffers; of the grid
/// also 5 buffers of values between the layers.
#[derive(Debug, Clone)]
pub struct Tape {
    kind: Kind,
    features: Vec<Vec<f32>>,
    /// For each layer, one for each block of anchors.
    records: Vec<Vec<Record>>,
    /// For each layer `[n, Message::SHOWN]`, if hidden values are kept.
    shown: Vec<Vec<f32>>,
    /// What the last perceptron activates, for each block of anchors; empty if hidden values are not kept.
    last: Vec<Vec<f32>>,
}

/// As [`forward`], with what [`backward`] needs.
///
/// # Panics
/// As [`forward`].
#[must_use]
pub fn forward_recorded(config: &Config, weights: &[f32], inputs: &Inputs<'_>) -> (Vec<f32>, Tape) {
    let mut tape = Tape {
        kind: config.kind,
        features: Vec::new(),
        records: Vec::new(),
        shown: Vec::new(),
        last: Vec::new(),
    };
    (outputs(config, weights, inputs, Some(&mut tape)), tape)
}

fn outputs(config: &Config, weights: &[f32], inputs: &Inputs<'_>, tape: Option<&mut Tape>) -> Vec<f32> {
    fn of<'a, M: Message<'a>>(
        config: &Config,
        weights: &'a [f32],
        inputs: &Inputs<'_>,
        tape: Option<&mut Tape>,
    ) -> Vec<f32> {
        Network::<M>::new(config, &Layout::new(config), weights).run(config, inputs, tape)
    }
    match config.kind {
        Kind::Attention => of::<Attention<'_>>(config, weights, inputs, tape),
        Kind::Mlp => of::<Mlp<'_>>(config, weights, inputs, tape),
        Kind::EdgeConv => of::<EdgeConv<'_>>(config, weights, inputs, tape),
        Kind::MaxPool => of::<MaxPool<'_>>(config, weights, inputs, tape),
        Kind::Grid => of::<Grid<'_>>(config, weights, inputs, tape),
    }
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

/// Gradients from those of the outputs `[n, 38]`; `tape` is that of the same weights and inputs. The gradient of a maximum that
/// several pairs share goes to the first of them.
///
/// # Panics
/// As [`forward`], or if `grad_out` or the tape is of another number of anchors, or the tape of another kind of head.
#[must_use]
pub fn backward(
    config: &Config,
    weights: &[f32],
    inputs: &Inputs<'_>,
    tape: &Tape,
    grad_out: &[f32],
) -> Gradients {
    fn of<'a, M: Message<'a>>(
        (config, weights, inputs): (&Config, &'a [f32], &Inputs<'_>),
        tape: &Tape,
        grad_out: &[f32],
    ) -> Gradients {
        let layout = &Layout::new(config);
        let network = &Network::<M>::new(config, layout, weights);
        Backward { config, layout, network, inputs }.run(tape, grad_out)
    }
    assert_eq!(grad_out.len(), inputs.n * OUTPUTS, "gradients of the outputs");
    assert_eq!(tape.kind, config.kind, "a tape of this kind of head");
    assert!(tape.features.iter().all(|rows| rows.len() == inputs.n * WIDTH), "a tape of as many anchors");
    let head = (config, weights, inputs);
    match config.kind {
        Kind::Attention => of::<Attention<'_>>(head, tape, grad_out),
        Kind::Mlp => of::<Mlp<'_>>(head, tape, grad_out),
        Kind::EdgeConv => of::<EdgeConv<'_>>(head, tape, grad_out),
        Kind::MaxPool => of::<MaxPool<'_>>(head, tape, grad_out),
        Kind::Grid => of::<Grid<'_>>(head, tape, grad_out),
    }
}
