//! Attention for each pair of an anchor and a neighbour. Nothing of the size of all pairs times the width
//! is ever stored: rows of an anchor's pairs live in the first-level cache.

use crate::fused::message::Row;
use crate::{HEAD_WIDTH, HEADS, Inputs, WIDTH};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::vector::{exp, map, relu, select};
use cpu_kernels::{Isa, dispatch};

/// A row for each attention head.
pub(super) type ByHead = [Row; HEADS];
/// Two rows of an anchor side by side: key and value, or what their gradients are made from.
pub(super) type TwoRows = [f32; 2 * WIDTH];

/// The anchors that one loop goes over, and all that they may look at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<'a> {
    pub(super) isa: Isa,
    /// The block's first anchor.
    pub(super) first: usize,
    pub(super) inputs: &'a Inputs<'a>,
    /// First layer of the offsets' perceptron: its columns x, y, z, and its bias.
    pub(super) offset: &'a ByHead,
    /// Keys and values of all anchors.
    pub(super) keys_values: &'a [TwoRows],
    /// Queries of the block, scaled by 1 / sqrt(32).
    pub(super) query: &'a [Row],
    /// u_c = W₂[c]ᵀ q_c of the block.
    pub(super) up: &'a [ByHead],
}

/// Memory for the pairs of one anchor, itself first.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    index: Vec<usize>,
    relative: Vec<[f32; 3]>,
    hidden: Vec<Row>,
}

impl Scratch {
    /// Looks up an anchor's neighbours and computes h_ij = ReLU(W₁ (p_j - p_i) + b₁).
    #[inline(always)]
    fn fill<S: Simd>(&mut self, simd: S, block: &Block<'_>, anchor: usize) {
        let Inputs { k, neighbours, relative, .. } = *block.inputs;
        self.index.clear();
        self.index.push(anchor);
        self.index.extend(neighbours[anchor * k..][..k].iter().map(|&j| j as usize));
        self.relative.clear();
        self.relative.push([0.0; 3]);
        self.relative.extend_from_slice(&relative[anchor * k..][..k]);
        self.hidden.resize(k + 1, [0.0; WIDTH]);
        for vector in 0..WIDTH / S::F32_LANES {
            let [x, y, z, bias] = block.offset.each_ref().map(|row| vectors::<S>(row)[vector]);
            for (hidden, &[rx, ry, rz]) in self.hidden.iter_mut().zip(&self.relative) {
                let sum = simd.mul_add_e_f32s(x, simd.splat_f32s(rx), bias);
                let sum = simd.mul_add_e_f32s(y, simd.splat_f32s(ry), sum);
                let sum = simd.mul_add_e_f32s(z, simd.splat_f32s(rz), sum);
                vectors_mut::<S>(hidden)[vector] = relu(simd, sum);
            }
        }
    }

    /// For each pair and head, the products with what is given by head along h_ij plus that with a row along `row_of(j)`.
    #[inline(always)]
    fn dots<'r, S: Simd>(
        &self,
        simd: S,
        along_hidden: &ByHead,
        along_row: &Row,
        row_of: impl Fn(usize) -> &'r Row,
        out: &mut [[f32; HEADS]],
    ) {
        // Two pairs at a time share what is loaded of `along_hidden`; of an odd number the last pair is done twice.
        let pairs = self.hidden.len();
        let along_hidden = along_hidden.each_ref().map(|row| vectors::<S>(row));
        let along_row = vectors::<S>(along_row);
        let per_head = HEAD_WIDTH / S::F32_LANES;
        for first in (0..pairs).step_by(2) {
            let both = [first, (first + 1).min(pairs - 1)];
            let hidden = both.map(|pair| vectors::<S>(&self.hidden[pair]));
            let rows = both.map(|pair| vectors::<S>(row_of(self.index[pair])));
            let mut sums = [[simd.splat_f32s(0.0); HEADS]; 2];
            for vector in 0..WIDTH / S::F32_LANES {
                let h = hidden.map(|hidden| hidden[vector]);
                for c in 0..HEADS {
                    let along = along_hidden[c][vector];
                    sums[0][c] = simd.mul_add_e_f32s(h[0], along, sums[0][c]);
                    sums[1][c] = simd.mul_add_e_f32s(h[1], along, sums[1][c]);
                }
            }
            for (vector, along) in along_row.iter().enumerate() {
                let c = vector / per_head;
                sums[0][c] = simd.mul_add_e_f32s(rows[0][vector], *along, sums[0][c]);
                sums[1][c] = simd.mul_add_e_f32s(rows[1][vector], *along, sums[1][c]);
            }
            for (pair, sums) in both.into_iter().zip(sums) {
                for (out, sum) in out[pair].iter_mut().zip(sums) {
                    *out = simd.reduce_sum_f32s(sum);
                }
            }
        }
    }

    /// For each head, the sum of h_ij over pairs with `weights`, and likewise that of its part of the rows `row_of(j)`.
    #[inline(always)]
    fn weighted<'r, S: Simd>(
        &self,
        simd: S,
        weights: &[[f32; HEADS]],
        row_of: impl Fn(usize) -> &'r Row,
        hidden_sum: &mut ByHead,
        row_sum: &mut Row,
    ) {
        let zero = simd.splat_f32s(0.0);
        let count = WIDTH / S::F32_LANES;
        // Two vectors of h_ij at a time share the weights.
        for start in (0..count).step_by(2) {
            let mut sums = [[zero; 2]; HEADS];
            for (hidden, weights) in self.hidden.iter().zip(weights) {
                let h = [vectors::<S>(hidden)[start], vectors::<S>(hidden)[start + 1]];
                for c in 0..HEADS {
                    let weight = simd.splat_f32s(weights[c]);
                    sums[c][0] = simd.mul_add_e_f32s(weight, h[0], sums[c][0]);
                    sums[c][1] = simd.mul_add_e_f32s(weight, h[1], sums[c][1]);
                }
            }
            for (out, sums) in hidden_sum.iter_mut().zip(sums) {
                vectors_mut::<S>(out)[start..start + 2].copy_from_slice(&sums);
            }
        }
        // Eight vectors of the rows: as many sums as hide the latency of an addition.
        let per_head = HEAD_WIDTH / S::F32_LANES;
        for start in (0..count).step_by(SUMS) {
            let mut sums = [zero; SUMS];
            for (&j, weights) in self.index.iter().zip(weights) {
                let row = &vectors::<S>(row_of(j))[start..start + SUMS];
                for (i, sum) in sums.iter_mut().enumerate() {
                    let weight = simd.splat_f32s(weights[(start + i) / per_head]);
                    *sum = simd.mul_add_e_f32s(weight, row[i], *sum);
                }
            }
            vectors_mut::<S>(row_sum)[start..start + SUMS].copy_from_slice(&sums);
        }
    }

    /// Adds to the gradients of [`Block::offset`] what comes through h_ij.
    #[inline(always)]
    fn offset_gradient<S: Simd>(
        &self,
        simd: S,
        (up, grad_logits): (&ByHead, &[[f32; HEADS]]),
        (grad_hidden, alphas): (&ByHead, &[[f32; HEADS]]),
        out: &mut ByHead,
    ) {
        let zero = simd.splat_f32s(0.0);
        for vector in 0..WIDTH / S::F32_LANES {
            let up = up.each_ref().map(|row| vectors::<S>(row)[vector]);
            let grad_hidden = grad_hidden.each_ref().map(|row| vectors::<S>(row)[vector]);
            let mut sums = out.each_ref().map(|row| vectors::<S>(row)[vector]);
            let weights = grad_logits.iter().zip(alphas);
            for ((hidden, relative), (grad_logit, alpha)) in
                self.hidden.iter().zip(&self.relative).zip(weights)
            {
                let mut grad = zero;
                for c in 0..HEADS {
                    grad = simd.mul_add_e_f32s(simd.splat_f32s(grad_logit[c]), up[c], grad);
                    grad = simd.mul_add_e_f32s(simd.splat_f32s(alpha[c]), grad_hidden[c], grad);
                }
                let live = simd.greater_than_f32s(vectors::<S>(hidden)[vector], zero);
                let grad = select(simd, live, grad, zero);
                for i in 0..3 {
                    sums[i] = simd.mul_add_e_f32s(simd.splat_f32s(relative[i]), grad, sums[i]);
                }
                sums[3] = simd.add_f32s(sums[3], grad);
            }
            for (out, sum) in out.iter_mut().zip(sums) {
                vectors_mut::<S>(out)[vector] = sum;
            }
        }
    }
}

/// Sums of rows in registers at a time.
pub(super) const SUMS: usize = 8;

/// For each anchor of a block its weights `[k + 1]`, the weighted sum of h_ij by head and of the values.
pub(super) fn attend(
    block: &Block<'_>,
    alphas: &mut [[f32; HEADS]],
    gathered: &mut [ByHead],
    mixed: &mut [Row],
    scratch: &mut Scratch,
) {
    dispatch(block.isa, Attend { block, alphas, gathered, mixed, scratch });
}

struct Attend<'a> {
    block: &'a Block<'a>,
    alphas: &'a mut [[f32; HEADS]],
    gathered: &'a mut [ByHead],
    mixed: &'a mut [Row],
    scratch: &'a mut Scratch,
}

impl WithSimd for Attend<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, alphas, gathered, mixed, scratch } = self;
        let pairs = block.inputs.k + 1;
        for (i, alphas) in alphas.chunks_exact_mut(pairs).enumerate() {
            scratch.fill(simd, block, block.first + i);
            let from_query = block.query[i].map(|q| -q);
            scratch.dots(simd, &block.up[i], &from_query, |j| key(&block.keys_values[j]), alphas);
            softmax(simd, alphas);
            let value = |j: usize| value(&block.keys_values[j]);
            scratch.weighted(simd, alphas, value, &mut gathered[i], &mut mixed[i]);
        }
    }
}

/// What the gradient needs and gives for the anchors of a block.
#[derive(Debug)]
pub(super) struct Gradient<'a> {
    pub(super) alphas: &'a [[f32; HEADS]],
    /// Gradient of the weighted sum of values.
    pub(super) mixed: &'a [Row],
    /// Gradient of the weighted sums of h_ij.
    pub(super) gathered: &'a [ByHead],
    /// Out: gradient of the logits.
    pub(super) logits: &'a mut [[f32; HEADS]],
    /// Out: gradient of [`Block::up`].
    pub(super) up: &'a mut [ByHead],
    /// Out: gradient of [`Block::query`], without what comes through `up`.
    pub(super) query: &'a mut [Row],
    /// Added to: gradient of [`Block::offset`].
    pub(super) offset: &'a mut ByHead,
}

/// Gradients of everything but keys and values.
pub(super) fn attend_backward(block: &Block<'_>, gradient: Gradient<'_>, scratch: &mut Scratch) {
    dispatch(block.isa, AttendBackward { block, gradient, scratch });
}

struct AttendBackward<'a> {
    block: &'a Block<'a>,
    gradient: Gradient<'a>,
    scratch: &'a mut Scratch,
}

impl WithSimd for AttendBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, gradient, scratch } = self;
        let pairs = block.inputs.k + 1;
        for (i, logits) in gradient.logits.chunks_exact_mut(pairs).enumerate() {
            let alphas = &gradient.alphas[i * pairs..][..pairs];
            scratch.fill(simd, block, block.first + i);
            // Gradient of the weights, then of the logits before softmax.
            let value = |j: usize| value(&block.keys_values[j]);
            scratch.dots(simd, &gradient.gathered[i], &gradient.mixed[i], value, logits);
            let mut mean = [0.0_f32; HEADS];
            for (alpha, grad) in alphas.iter().zip(logits.iter()) {
                for c in 0..HEADS {
                    mean[c] += alpha[c] * grad[c];
                }
            }
            for (alpha, grad) in alphas.iter().zip(logits.iter_mut()) {
                for c in 0..HEADS {
                    grad[c] = alpha[c] * (grad[c] - mean[c]);
                }
            }
            let key = |j: usize| key(&block.keys_values[j]);
            scratch.weighted(simd, logits, key, &mut gradient.up[i], &mut gradient.query[i]);
            gradient.query[i] = gradient.query[i].map(|v| -v);
            let by_hidden = (&block.up[i], &*logits);
            scratch.offset_gradient(simd, by_hidden, (&gradient.gathered[i], alphas), gradient.offset);
        }
    }
}

#[inline(always)]
fn key(rows: &TwoRows) -> &Row {
    rows.first_chunk().expect("two rows")
}

#[inline(always)]
fn value(rows: &TwoRows) -> &Row {
    rows.last_chunk().expect("two rows")
}

/// Weights of an anchor's pairs from their logits, by head.
#[inline(always)]
fn softmax<S: Simd>(simd: S, logits: &mut [[f32; HEADS]]) {
    let mut most = [f32::NEG_INFINITY; HEADS];
    for logit in logits.iter() {
        for c in 0..HEADS {
            most[c] = most[c].max(logit[c]);
        }
    }
    for logit in logits.iter_mut() {
        for c in 0..HEADS {
            logit[c] -= most[c];
        }
    }
    map(
        simd,
        logits.as_flattened_mut(),
        #[inline(always)]
        |v| exp(simd, v),
    );
    let mut sum = [0.0_f32; HEADS];
    for logit in logits.iter() {
        for c in 0..HEADS {
            sum[c] += logit[c];
        }
    }
    for logit in logits.iter_mut() {
        for c in 0..HEADS {
            logit[c] /= sum[c];
        }
    }
}

/// A row in vectors, which divide it without rest.
#[inline(always)]
fn vectors<S: Simd>(row: &Row) -> &[S::f32s] {
    S::as_simd_f32s(row).0
}

#[inline(always)]
fn vectors_mut<S: Simd>(row: &mut Row) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(row).0
}
