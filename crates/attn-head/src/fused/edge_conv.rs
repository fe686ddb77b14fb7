//! Edge convolution: the maximum over j of a perceptron of [h_i ; h_j - h_i ; p_j - p_i].
//!
//! The first layer of a pair is A h_i + B (h_j - h_i) + P (p_j - p_i) + b. So an anchor shows other = B h and
//! own = A h + b - B h, and the layer is a sum of rows, see [`super::maximum`].

use super::linear::Linear;
use super::maximum::{Maxima, Maximum, Sent, Work};
use super::message::{Anchors, Kept, Message, rows};
use super::sums::Sums;
use crate::{Layout, WIDTH};
use cpu_kernels::rows::add;
use cpu_kernels::{Isa, Rows};

/// Parameters of the edge convolution in a layer.
#[derive(Debug)]
pub(super) struct EdgeConv<'a> {
    isa: Isa,
    own: Linear<'a>,
    other: Linear<'a>,
    maximum: Maximum<'a>,
}

impl<'a> Message<'a> for EdgeConv<'a> {
    /// Other and own.
    const SHOWN: usize = 2 * WIDTH;
    type Work = Work;
    type Sent = Sent;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let first = format!("{name}.edge.0");
        let [anchor, other, position] = Linear::parts(isa, layout, values, &first, [WIDTH, WIDTH, 3]);
        let maximum = Maximum::new(isa, layout, values, position, &format!("{name}.edge.2"));
        Self { isa, own: anchor, other, maximum }
    }

    fn show(&self, h: Rows<'_>, shown: &mut [f32]) {
        self.other.apply(h, shown, 2 * WIDTH);
        self.own.apply(h, &mut shown[WIDTH..], 2 * WIDTH);
        for row in shown.chunks_exact_mut(2 * WIDTH) {
            let (other, anchor) = row.split_at_mut(WIDTH);
            subtract(anchor, other);
        }
    }

    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], maxima: Option<&mut Maxima>, work: &mut Work) {
        self.maximum.run(anchors, maxima, work);
        add(self.isa, y, &work.values);
    }

    fn add_again(&self, _: Anchors<'_>, y: &mut [f32], maxima: &Maxima, _: &mut Work) {
        add(self.isa, y, &maxima.values);
    }

    fn backward(
        &self,
        anchors: Anchors<'_>,
        maxima: &Maxima,
        grad: &[f32],
        grad_h: &mut [f32],
        sent: &mut Sent,
        sums: &mut Sums<'_>,
        _: &mut Work,
    ) {
        sent.grad.clear();
        sent.grad.extend_from_slice(grad);
        self.maximum.backward(anchors, maxima, sent, true, sums);
        self.own.weight_gradient(anchors.h(), rows(&sent.own), sums);
        self.own.input_gradient(rows(&sent.own), grad_h);
    }

    fn shown_backward(
        &self,
        anchors: Anchors<'_>,
        kept: Kept<'_, Sent>,
        grad_h: &mut [f32],
        sums: &mut Sums<'_>,
        work: &mut Work,
    ) {
        self.maximum.gather(anchors, kept, work);
        // What an anchor shows as other is part of its own with the sign minus.
        subtract(&mut work.grad_other, &kept.sent_by(anchors.first).own);
        let grad_other = rows(&work.grad_other);
        self.other.weight_gradient(anchors.h(), grad_other, sums);
        self.other.input_gradient(grad_other, grad_h);
    }
}

fn subtract(values: &mut [f32], others: &[f32]) {
    values.iter_mut().zip(others).for_each(|(v, other)| *v -= other);
}
