//! The maximum over an anchor's pairs, channel by channel: what edge convolution and max pooling share.
//!
//! ```text
//! h_ij   = ReLU(own_i + other_j + P (p_j - p_i))               [128]
//! out[c] = max over j of (W2 h_ij)[c] + b2[c]
//! ```
//!
//! `other` and `own`, which max pooling lacks, are computed once per anchor. W2 takes the pairs of a few anchors at a
//! time, so that their rows stay in the second-level cache.
//!
//! The gradient of a channel goes to one pair: to the first of those with the maximum, as in the plain form. So the
//! forward pass records which channels each pair has, and gradients are products of single rows. They cost as much
//! as W2 for one pair of each anchor.

mod kernels;
mod record;

use super::linear::Linear;
use super::message::{All, Anchors, Kept, Row, each, each_mut, resize, rows, zero};
use super::sums::{Place, Sums};
use crate::{Layout, WIDTH};
use cpu_kernels::{Isa, dispatch};
use kernels::{Gather, Gradient, Hidden, Largest, Pairs};
pub(super) use record::Maxima;

/// Pairs whose rows are in memory at a time, if one anchor does not have more: 100 kB each before and behind W2.
const PAIRS: usize = 200;

/// Parameters of the pairs' perceptron, but for what is computed once per anchor.
#[derive(Debug)]
pub(super) struct Maximum<'a> {
    isa: Isa,
    position: Linear<'a>,
    /// The columns x, y, z of P.
    columns: [Row; 3],
    last: Linear<'a>,
    /// W2.
    last_weight: &'a [Row],
}

#[derive(Debug, Default)]
pub(super) struct Work {
    hidden: Vec<f32>,
    products: Vec<f32>,
    /// The maxima of a block.
    pub(super) values: Vec<f32>,
    /// The gradient of `other` of a block.
    pub(super) grad_other: Vec<f32>,
}

/// What a block keeps for those that it looks at.
#[derive(Debug, Default)]
pub(super) struct Sent {
    /// Gradient of the maxima.
    pub(super) grad: Vec<f32>,
    /// Gradient of `own`, if there is one.
    pub(super) own: Vec<f32>,
}

impl<'a> Maximum<'a> {
    /// `position` is P, `last` the name of W2.
    pub(super) fn new(
        isa: Isa,
        layout: &Layout,
        values: &'a [f32],
        position: Linear<'a>,
        last: &str,
    ) -> Self {
        let weight = position.weight();
        let columns = std::array::from_fn(|axis| std::array::from_fn(|d| weight.row(d)[axis]));
        let last_weight = each(Place::pair(layout, last).0.of(values));
        Self { isa, position, columns, last: Linear::new(isa, layout, values, last), last_weight }
    }

    fn pairs<'p>(&'p self, all: All<'p>) -> Pairs<'p> {
        let width = all.shown.len() / all.inputs.n;
        Pairs { inputs: all.inputs, shown: all.shown, width, position: &self.columns }
    }

    /// The maxima of a block, left in `work`, and recorded if asked for.
    pub(super) fn run(&self, anchors: Anchors<'_>, mut record: Option<&mut Maxima>, work: &mut Work) {
        let (count, per_anchor) = (anchors.count, anchors.all.inputs.k + 1);
        let pairs = self.pairs(anchors.all);
        if let Some(record) = &mut record {
            record.clear();
        }
        resize(&mut work.values, count * WIDTH);
        let at_a_time = (PAIRS / per_anchor).max(1);
        for (part, values) in work.values.chunks_mut(at_a_time * WIDTH).enumerate() {
            let size = values.len() * per_anchor;
            resize(&mut work.hidden, size);
            resize(&mut work.products, size);
            let (first, hidden) = (anchors.first + part * at_a_time, each_mut(&mut work.hidden));
            dispatch(self.isa, Hidden { pairs, first, out: hidden });
            self.last.product(rows(&work.hidden), &mut work.products, WIDTH, false);
            for (products, values) in each(&work.products).chunks_exact(per_anchor).zip(each_mut(values)) {
                let mut picks = [0; WIDTH];
                dispatch(self.isa, Largest { products, values, picks: &mut picks });
                if let Some(record) = &mut record {
                    record.push(per_anchor, &picks);
                }
            }
        }
        self.last.add_bias(&mut work.values);
        if let Some(record) = record {
            record.values.extend_from_slice(&work.values);
        }
    }

    /// From the gradient of the maxima in `sent`, gradients of the weights; and of `own`, if there is one.
    pub(super) fn backward(
        &self,
        anchors: Anchors<'_>,
        maxima: &Maxima,
        sent: &mut Sent,
        with_own: bool,
        sums: &mut Sums<'_>,
    ) {
        let grad = each(&sent.grad);
        self.last.bias_gradient(rows(&sent.grad), sums);
        zero(&mut sent.own, if with_own { sent.grad.len() } else { 0 });
        let mut position = [[0.0; WIDTH]; 3];
        dispatch(
            self.isa,
            Gradient {
                pairs: self.pairs(anchors.all),
                last: self.last_weight,
                first: anchors.first,
                maxima,
                grad,
                own: each_mut(&mut sent.own),
                last_sum: each_mut(self.last.weight_sum(sums).0),
                position_sum: &mut position,
            },
        );
        let (sum, stride) = self.position.weight_sum(sums);
        for (d, sum) in sum.chunks_mut(stride).enumerate() {
            (0..3).for_each(|axis| sum[axis] += position[axis][d]);
        }
    }

    /// The gradients of `other` of a block, left in `work`.
    pub(super) fn gather(&self, anchors: Anchors<'_>, kept: Kept<'_, Sent>, work: &mut Work) {
        resize(&mut work.grad_other, anchors.h.len());
        let gather = Gather {
            pairs: self.pairs(anchors.all),
            last: self.last_weight,
            first: anchors.first,
            kept,
            out: each_mut(&mut work.grad_other),
        };
        dispatch(self.isa, gather);
    }
}
