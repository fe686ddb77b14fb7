//! What attention does with each pair of an anchor and a neighbour. Nothing of the size of all pairs times the width
//! is ever stored: rows of an anchor's pairs live in the first-level cache.

use super::math::{exp, mul_add, relu};
use crate::{HEAD_WIDTH, HEADS, Inputs, WIDTH};
use multiversion::{multiversion, target::target_cfg_f};

/// A row of features.
pub(super) type Row = [f32; WIDTH];
/// A row for each attention head.
pub(super) type ByHead = [Row; HEADS];
/// Two rows of an anchor side by side: key and value, or what their gradients are made from.
pub(super) type TwoRows = [f32; 2 * WIDTH];

/// Terms at a time: a 256-bit register.
const LANES: usize = 8;

/// The anchors that one loop goes over, and all that they may look at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<'a> {
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
    fn fill<const FMA: bool>(&mut self, block: &Block<'_>, anchor: usize) {
        let Inputs { k, neighbours, relative, .. } = *block.inputs;
        self.index.clear();
        self.index.push(anchor);
        self.index.extend(neighbours[anchor * k..][..k].iter().map(|&j| j as usize));
        self.relative.clear();
        self.relative.push([0.0; 3]);
        self.relative.extend_from_slice(&relative[anchor * k..][..k]);
        self.hidden.resize(k + 1, [0.0; WIDTH]);
        let [x, y, z, bias] = block.offset;
        for (hidden, r) in self.hidden.iter_mut().zip(&self.relative) {
            for d in 0..WIDTH {
                let sum = mul_add::<FMA>(x[d], r[0], bias[d]);
                hidden[d] = relu(mul_add::<FMA>(z[d], r[2], mul_add::<FMA>(y[d], r[1], sum)));
            }
        }
    }

    /// For each pair and head, the products with what is given by head along h_ij plus that with a row along `of(j)`.
    #[inline(always)]
    fn dots<'r, const FMA: bool>(
        &self,
        along_hidden: &ByHead,
        along_row: &Row,
        of: impl Fn(usize) -> &'r Row,
        out: &mut [[f32; HEADS]],
    ) {
        for ((hidden, &j), out) in self.hidden.iter().zip(&self.index).zip(out) {
            // Four chains of sums in registers: arrays of arrays would not be kept there.
            let [mut a, mut b, mut c, mut d] = [[0.0; LANES]; HEADS];
            let rows = lanes(hidden).iter().zip(lanes(&along_hidden[0])).zip(lanes(&along_hidden[1]));
            let rows = rows.zip(lanes(&along_hidden[2])).zip(lanes(&along_hidden[3]));
            for ((((h, along_a), along_b), along_c), along_d) in rows {
                a = add_product::<FMA>(h, along_a, a);
                b = add_product::<FMA>(h, along_b, b);
                c = add_product::<FMA>(h, along_c, c);
                d = add_product::<FMA>(h, along_d, d);
            }
            let parts = of(j).as_chunks::<HEAD_WIDTH>().0.iter().zip(along_row.as_chunks::<HEAD_WIDTH>().0);
            for ((part, along), sum) in parts.zip([&mut a, &mut b, &mut c, &mut d]) {
                for (part, along) in part.as_chunks().0.iter().zip(along.as_chunks().0) {
                    *sum = add_product::<FMA>(part, along, *sum);
                }
            }
            *out = [a, b, c, d].map(total);
        }
    }

    /// For each head, the sum of h_ij over pairs with `weights`, and likewise that of its part of the rows `of(j)`.
    #[inline(always)]
    fn weighted<'r, const FMA: bool>(
        &self,
        weights: &[[f32; HEADS]],
        of: impl Fn(usize) -> &'r Row,
        hidden_sum: &mut ByHead,
        row_sum: &mut Row,
    ) {
        for at in (0..WIDTH).step_by(LANES) {
            let mut sums = [[0.0_f32; LANES]; HEADS];
            for (hidden, weights) in self.hidden.iter().zip(weights) {
                for c in 0..HEADS {
                    for l in 0..LANES {
                        sums[c][l] = mul_add::<FMA>(weights[c], hidden[at + l], sums[c][l]);
                    }
                }
            }
            for (out, sums) in hidden_sum.iter_mut().zip(sums) {
                out[at..at + LANES].copy_from_slice(&sums);
            }
        }
        for c in 0..HEADS {
            let part = c * HEAD_WIDTH..(c + 1) * HEAD_WIDTH;
            let mut sums = [0.0_f32; HEAD_WIDTH];
            for (&j, weights) in self.index.iter().zip(weights) {
                let row = &of(j)[part.clone()];
                for l in 0..HEAD_WIDTH {
                    sums[l] = mul_add::<FMA>(weights[c], row[l], sums[l]);
                }
            }
            row_sum[part].copy_from_slice(&sums);
        }
    }

    /// Adds to the gradients of [`Block::offset`] what comes through h_ij.
    #[inline(always)]
    fn offset_gradient<const FMA: bool>(
        &self,
        (up, grad_logits): (&ByHead, &[[f32; HEADS]]),
        (grad_hidden, alphas): (&ByHead, &[[f32; HEADS]]),
        out: &mut ByHead,
    ) {
        for at in (0..WIDTH).step_by(LANES) {
            let mut sums: [[f32; LANES]; 4] =
                std::array::from_fn(|i| std::array::from_fn(|l| out[i][at + l]));
            let weights = grad_logits.iter().zip(alphas);
            for ((hidden, relative), (grad_logit, alpha)) in
                self.hidden.iter().zip(&self.relative).zip(weights)
            {
                let mut grad = [0.0_f32; LANES];
                for c in 0..HEADS {
                    for l in 0..LANES {
                        grad[l] = mul_add::<FMA>(grad_logit[c], up[c][at + l], grad[l]);
                        grad[l] = mul_add::<FMA>(alpha[c], grad_hidden[c][at + l], grad[l]);
                    }
                }
                for l in 0..LANES {
                    grad[l] = if hidden[at + l] > 0.0 { grad[l] } else { 0.0 };
                    for i in 0..3 {
                        sums[i][l] = mul_add::<FMA>(relative[i], grad[l], sums[i][l]);
                    }
                    sums[3][l] += grad[l];
                }
            }
            for (out, sums) in out.iter_mut().zip(sums) {
                out[at..at + LANES].copy_from_slice(&sums);
            }
        }
    }
}

/// For each anchor of a block its weights `[k + 1]`, the weighted sum of h_ij by head and of the values.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn attend(
    block: &Block,
    alphas: &mut [[f32; HEADS]],
    gathered: &mut [ByHead],
    mixed: &mut [Row],
    scratch: &mut Scratch,
) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        attend_with::<true>(block, alphas, gathered, mixed, scratch);
    } else {
        attend_with::<false>(block, alphas, gathered, mixed, scratch);
    }
}

#[inline(always)]
fn attend_with<const FMA: bool>(
    block: &Block<'_>,
    alphas: &mut [[f32; HEADS]],
    gathered: &mut [ByHead],
    mixed: &mut [Row],
    scratch: &mut Scratch,
) {
    let pairs = block.inputs.k + 1;
    for (i, alphas) in alphas.chunks_exact_mut(pairs).enumerate() {
        scratch.fill::<FMA>(block, block.first + i);
        let from_query = block.query[i].map(|q| -q);
        scratch.dots::<FMA>(&block.up[i], &from_query, |j| key(&block.keys_values[j]), alphas);
        softmax::<FMA>(alphas);
        let value = |j: usize| value(&block.keys_values[j]);
        scratch.weighted::<FMA>(alphas, value, &mut gathered[i], &mut mixed[i]);
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
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn attend_backward(block: &Block, gradient: &mut Gradient, scratch: &mut Scratch) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        attend_backward_with::<true>(block, gradient, scratch);
    } else {
        attend_backward_with::<false>(block, gradient, scratch);
    }
}

#[inline(always)]
fn attend_backward_with<const FMA: bool>(
    block: &Block<'_>,
    gradient: &mut Gradient<'_>,
    scratch: &mut Scratch,
) {
    let pairs = block.inputs.k + 1;
    for (i, logits) in gradient.logits.chunks_exact_mut(pairs).enumerate() {
        let alphas = &gradient.alphas[i * pairs..][..pairs];
        scratch.fill::<FMA>(block, block.first + i);
        // Gradient of the weights, then of the logits before softmax.
        let value = |j: usize| value(&block.keys_values[j]);
        scratch.dots::<FMA>(&gradient.gathered[i], &gradient.mixed[i], value, logits);
        let mut mean = [0.0_f32; HEADS];
        for (alpha, grad) in alphas.iter().zip(logits.iter()) {
            for c in 0..HEADS {
                mean[c] = mul_add::<FMA>(alpha[c], grad[c], mean[c]);
            }
        }
        for (alpha, grad) in alphas.iter().zip(logits.iter_mut()) {
            for c in 0..HEADS {
                grad[c] = alpha[c] * (grad[c] - mean[c]);
            }
        }
        let key = |j: usize| key(&block.keys_values[j]);
        scratch.weighted::<FMA>(logits, key, &mut gradient.up[i], &mut gradient.query[i]);
        gradient.query[i] = gradient.query[i].map(|v| -v);
        let by_hidden = (&block.up[i], &*logits);
        scratch.offset_gradient::<FMA>(by_hidden, (&gradient.gathered[i], alphas), gradient.offset);
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
fn softmax<const FMA: bool>(logits: &mut [[f32; HEADS]]) {
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
    logits.as_flattened_mut().iter_mut().for_each(|v| *v = exp::<FMA>(*v));
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

/// A row in registers' widths.
#[inline(always)]
fn lanes(row: &Row) -> &[[f32; LANES]] {
    row.as_chunks().0
}

/// sum + a b, lane by lane.
#[inline(always)]
fn add_product<const FMA: bool>(a: &[f32; LANES], b: &[f32; LANES], sum: [f32; LANES]) -> [f32; LANES] {
    std::array::from_fn(|l| mul_add::<FMA>(a[l], b[l], sum[l]))
}

#[inline(always)]
fn total(lanes: [f32; LANES]) -> f32 {
    let four: [f32; 4] = std::array::from_fn(|l| lanes[l] + lanes[l + 4]);
    (four[0] + four[2]) + (four[1] + four[3])
}
