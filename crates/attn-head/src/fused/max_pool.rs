//! Max pooling: a layer of h_i and of the maximum over j of a perceptron of [h_j ; p_j - p_i], see [`super::maximum`].

use super::linear::Linear;
use super::maximum::{Maxima, Maximum, Sent, Work};
use super::message::{Anchors, Kept, Message, rows, zero};
use super::sums::Sums;
use crate::{Layout, WIDTH};
use cpu_kernels::{Isa, Rows};

/// Parameters of the max pooling in a layer.
#[derive(Debug)]
pub(super) struct MaxPool<'a> {
    other: Linear<'a>,
    maximum: Maximum<'a>,
    /// The parts of the last layer for h_i and for the maximum.
    own: Linear<'a>,
    pooled: Linear<'a>,
}

impl<'a> Message<'a> for MaxPool<'a> {
    const SHOWN: usize = WIDTH;
    type Work = Work;
    type Sent = Sent;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let [other, position] = Linear::parts(isa, layout, values, &format!("{name}.pool.0"), [WIDTH, 3]);
        let maximum = Maximum::new(isa, layout, values, position, &format!("{name}.pool.2"));
        let [anchor, pooled] = Linear::parts(isa, layout, values, &format!("{name}.join"), [WIDTH; 2]);
        Self { other, maximum, own: anchor, pooled }
    }

    fn show(&self, h: Rows<'_>, shown: &mut [f32]) {
        self.other.apply(h, shown, WIDTH);
    }

    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], maxima: Option<&mut Maxima>, work: &mut Work) {
        self.maximum.run(anchors, maxima, work);
        self.join(anchors, &work.values, y);
    }

    fn add_again(&self, anchors: Anchors<'_>, y: &mut [f32], maxima: &Maxima, _: &mut Work) {
        self.join(anchors, &maxima.values, y);
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
        let grad = rows(grad);
        self.own.weight_gradient(anchors.h(), grad, sums);
        self.own.input_gradient(grad, grad_h);
        self.pooled.weight_gradient(rows(&maxima.values), grad, sums);
        zero(&mut sent.grad, maxima.values.len());
        self.pooled.input_gradient(grad, &mut sent.grad);
        self.maximum.backward(anchors, maxima, sent, false, sums);
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
        let grad_other = rows(&work.grad_other);
        self.other.weight_gradient(anchors.h(), grad_other, sums);
        self.other.input_gradient(grad_other, grad_h);
    }
}

impl MaxPool<'_> {
    fn join(&self, anchors: Anchors<'_>, pooled: &[f32], y: &mut [f32]) {
        self.own.add(anchors.h(), y);
        self.pooled.add(rows(pooled), y);
    }
}
