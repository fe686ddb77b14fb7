//! Geo-aware attention.
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

mod gather;
mod pairs;

use super::linear::Linear;
use super::maximum::Maxima;
use super::message::{Anchors, Kept, Message, each, each_mut, resize, rows, zero};
use super::sums::{Place, Sums};
use crate::{HEAD_WIDTH, HEADS, Layout, WIDTH};
use cpu_kernels::rows as each_row;
use cpu_kernels::{Isa, Packed, Rows, multiply, multiply_transposed};
use pairs::{ByHead, TwoRows};

/// Parameters of the attention in a layer.
#[derive(Debug)]
pub(super) struct Attention<'a> {
    isa: Isa,
    query: Linear<'a>,
    key: Linear<'a>,
    value: Linear<'a>,
    offset: ByHead,
    offset_at: (Place, Place),
    /// W₂[c], which takes rows of a head to rows of h_ij.
    up: [Packed; HEADS],
    /// W₂[c]ᵀ, which takes sums of h_ij to rows of a head.
    down: [Packed; HEADS],
    down_bias: &'a [f32],
    down_at: (Place, Place),
    project: Linear<'a>,
}

#[derive(Debug, Default)]
pub(super) struct Work {
    /// Weights of the pairs, `[rows, k + 1]`.
    alphas: Vec<[f32; HEADS]>,
    query: Vec<f32>,
    up: Vec<f32>,
    gathered: Vec<f32>,
    mixed: Vec<f32>,
    grad_mixed: Vec<f32>,
    grad_query: Vec<f32>,
    grad_up: Vec<f32>,
    grad_gathered: Vec<f32>,
    grad_shown: Vec<f32>,
    pairs: pairs::Scratch,
}

#[derive(Debug, Default)]
pub(super) struct Sent {
    /// `[rows, k + 1]`.
    alphas: Vec<[f32; HEADS]>,
    /// Gradients of the logits, `[rows, k + 1]`.
    logits: Vec<[f32; HEADS]>,
    /// The scaled query, and the gradient of the weighted sum of values.
    rows: Vec<TwoRows>,
}

/// 1 / sqrt(width of a head).
const SCALE: f32 = 0.176_776_7;

impl<'a> Message<'a> for Attention<'a> {
    /// Key and value.
    const SHOWN: usize = 2 * WIDTH;
    type Work = Work;
    type Sent = Sent;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let linear = |part: &str| Linear::new(isa, layout, values, &format!("{name}.attn.{part}"));
        let offset_at = Place::pair(layout, &format!("{name}.attn.delta.0"));
        let down_at = Place::pair(layout, &format!("{name}.attn.delta.2"));
        let (columns, bias) = (offset_at.0.of(values), offset_at.1.of(values));
        let offset = std::array::from_fn(|i| {
            std::array::from_fn(|d| if i < 3 { columns[3 * d + i] } else { bias[d] })
        });
        let second = Rows::new(down_at.0.of(values), WIDTH, WIDTH);
        let of_head = |c: usize| second.slice(c * HEAD_WIDTH..(c + 1) * HEAD_WIDTH);
        Self {
            isa,
            query: linear("q"),
            key: linear("k"),
            value: linear("v"),
            offset,
            offset_at,
            up: std::array::from_fn(|c| Packed::rows(isa, of_head(c))),
            down: std::array::from_fn(|c| Packed::transposed(isa, of_head(c))),
            down_bias: down_at.1.of(values),
            down_at,
            project: linear("proj"),
        }
    }

    fn show(&self, h: Rows<'_>, shown: &mut [f32]) {
        self.key.apply(h, shown, 2 * WIDTH);
        self.value.apply(h, &mut shown[WIDTH..], 2 * WIDTH);
    }

    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], _: Option<&mut Maxima>, work: &mut Work) {
        let size = anchors.h.len();
        for part in [&mut work.query, &mut work.mixed] {
            resize(part, size);
        }
        for part in [&mut work.up, &mut work.gathered] {
            resize(part, HEADS * size);
        }
        resize(&mut work.alphas, anchors.count * (anchors.all.inputs.k + 1));
        self.query.apply(anchors.h(), &mut work.query, WIDTH);
        work.query.iter_mut().for_each(|q| *q *= SCALE);
        self.go_up(&work.query, &mut work.up);
        pairs::attend(
            &self.block(anchors, &work.query, &work.up),
            &mut work.alphas,
            by_head_mut(&mut work.gathered),
            each_mut(&mut work.mixed),
            &mut work.pairs,
        );
        each_row::add_to_each(self.isa, &mut work.mixed, self.down_bias);
        self.go_down(&work.gathered, &mut work.mixed);
        self.project.add(rows(&work.mixed), y);
    }

    fn backward(
        &self,
        anchors: Anchors<'_>,
        _: &Maxima,
        grad: &[f32],
        grad_h: &mut [f32],
        sent: &mut Sent,
        sums: &mut Sums<'_>,
        work: &mut Work,
    ) {
        let size = grad.len();
        // Projection: from here on gradients of the weighted sums.
        self.project.weight_gradient(rows(&work.mixed), rows(grad), sums);
        let grad_mixed = &mut work.grad_mixed;
        zero(grad_mixed, size);
        self.project.input_gradient(rows(grad), grad_mixed);
        each_row::add_sum(self.isa, rows(grad_mixed), sums.at(self.down_at.1));
        resize(&mut work.grad_gathered, HEADS * size);
        self.go_up(grad_mixed, &mut work.grad_gathered);
        // Pairs.
        resize(&mut work.grad_query, size);
        resize(&mut work.grad_up, HEADS * size);
        resize(&mut sent.logits, work.alphas.len());
        let mut offset = [[0.0; WIDTH]; 4];
        let gradient = pairs::Gradient {
            alphas: &work.alphas,
            mixed: each(grad_mixed),
            gathered: by_head(&work.grad_gathered),
            logits: &mut sent.logits,
            up: by_head_mut(&mut work.grad_up),
            query: each_mut(&mut work.grad_query),
            offset: &mut offset,
        };
        pairs::attend_backward(&self.block(anchors, &work.query, &work.up), gradient, &mut work.pairs);
        self.offset_gradient(&offset, sums);
        self.down_gradient(work, sums);
        sent.send(work);
        // Queries.
        self.go_down(&work.grad_up, &mut work.grad_query);
        work.grad_query.iter_mut().for_each(|q| *q *= SCALE);
        self.query.weight_gradient(anchors.h(), rows(&work.grad_query), sums);
        self.query.input_gradient(rows(&work.grad_query), grad_h);
    }

    fn shown_backward(
        &self,
        anchors: Anchors<'_>,
        kept: Kept<'_, Sent>,
        grad_h: &mut [f32],
        sums: &mut Sums<'_>,
        work: &mut Work,
    ) {
        let grad_shown = &mut work.grad_shown;
        resize(grad_shown, anchors.count * Self::SHOWN);
        gather::gather(self.isa, kept, anchors.first, grad_shown.as_chunks_mut().0);
        let both = Rows::new(grad_shown, anchors.count, Self::SHOWN);
        for (part, linear) in [&self.key, &self.value].into_iter().enumerate() {
            let grad_out = both.columns(part * WIDTH, WIDTH);
            linear.weight_gradient(anchors.h(), grad_out, sums);
            linear.input_gradient(grad_out, grad_h);
        }
    }
}

impl Attention<'_> {
    fn block<'b>(&'b self, anchors: Anchors<'b>, query: &'b [f32], up: &'b [f32]) -> pairs::Block<'b> {
        pairs::Block {
            isa: self.isa,
            first: anchors.first,
            inputs: anchors.all.inputs,
            offset: &self.offset,
            keys_values: anchors.all.shown.as_chunks().0,
            query: each(query),
            up: by_head(up),
        }
    }

    fn offset_gradient(&self, offset: &ByHead, sums: &mut Sums<'_>) {
        let [columns @ .., bias] = offset;
        for (i, column) in columns.iter().enumerate() {
            let sum = sums.at(self.offset_at.0).iter_mut().skip(i).step_by(3);
            sum.zip(column).for_each(|(sum, v)| *sum += v);
        }
        sums.add(self.offset_at.1, bias);
    }

    /// Of W₂, which takes queries up and sums down.
    fn down_gradient(&self, work: &Work, sums: &mut Sums<'_>) {
        for c in 0..HEADS {
            let part = c * HEAD_WIDTH * WIDTH..(c + 1) * HEAD_WIDTH * WIDTH;
            let sum = &mut sums.at(self.down_at.0)[part];
            let of_head = |x| rows(x).columns(c * HEAD_WIDTH, HEAD_WIDTH);
            multiply_transposed(self.isa, of_head(&work.grad_mixed), head(&work.gathered, c), sum, WIDTH);
            multiply_transposed(self.isa, of_head(&work.query), head(&work.grad_up, c), sum, WIDTH);
        }
    }

    /// Rows to rows of h_ij by head.
    fn go_up(&self, x: &[f32], out: &mut [f32]) {
        for (c, up) in self.up.iter().enumerate() {
            let part = rows(x).columns(c * HEAD_WIDTH, HEAD_WIDTH);
            multiply(part, up, &mut out[c * WIDTH..], HEADS * WIDTH, false);
        }
    }

    /// Adds rows of h_ij by head, taken back, to rows.
    fn go_down(&self, x: &[f32], out: &mut [f32]) {
        for (c, down) in self.down.iter().enumerate() {
            multiply(head(x, c), down, &mut out[c * HEAD_WIDTH..], WIDTH, true);
        }
    }
}

impl Sent {
    /// Keeps what those that the block looks at need. The weights are taken from `work`, which no longer needs them.
    fn send(&mut self, work: &mut Work) {
        std::mem::swap(&mut self.alphas, &mut work.alphas);
        self.rows.resize(work.query.len() / WIDTH, [0.0; 2 * WIDTH]);
        let both = each(&work.query).iter().zip(each(&work.grad_mixed));
        for (sent, (query, grad_mixed)) in self.rows.iter_mut().zip(both) {
            sent[..WIDTH].copy_from_slice(query);
            sent[WIDTH..].copy_from_slice(grad_mixed);
        }
    }
}

/// One head's rows of h_ij.
fn head(values: &[f32], c: usize) -> Rows<'_> {
    Rows::new(values, values.len() / (HEADS * WIDTH), HEADS * WIDTH).columns(c * WIDTH, WIDTH)
}

fn by_head(values: &[f32]) -> &[ByHead] {
    each(values).as_chunks().0
}

fn by_head_mut(values: &mut [f32]) -> &mut [ByHead] {
    each_mut(values).as_chunks_mut().0
}
