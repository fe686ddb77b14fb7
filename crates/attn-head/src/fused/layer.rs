//! One block of the network: a message from the neighbours, then a perceptron, each with a residual.

use super::message::{All, Anchors, Kept, Message, Record, resize, rows, zero};
use super::norm::Norm;
use super::perceptron::{Hidden, Perceptron};
use super::sums::Sums;
use crate::{Layout, WIDTH};
use cpu_kernels::{Activation, Isa};

/// Parameters of a layer, ready for products.
#[derive(Debug)]
pub(super) struct Layer<'a, M> {
    norm1: Norm<'a>,
    message: M,
    norm2: Norm<'a>,
    perceptron: Perceptron<'a>,
}

/// Memory for a block of anchors.
#[derive(Debug, Default)]
pub(super) struct Workspace<W> {
    h: Vec<f32>,
    residual: Vec<f32>,
    normal: Vec<f32>,
    grad_normal: Vec<f32>,
    hidden: Hidden,
    message: W,
}

impl<'a, M: Message<'a>> Layer<'a, M> {
    pub(super) fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        Self {
            norm1: Norm::new(isa, layout, values, &format!("{name}.norm1")),
            message: M::new(isa, layout, values, name),
            norm2: Norm::new(isa, layout, values, &format!("{name}.norm2")),
            perceptron: Perceptron::new(isa, layout, values, &format!("{name}.ffn"), Activation::Gelu),
        }
    }

    /// What rows show to those that look at them.
    pub(super) fn show(&self, x: &[f32], shown: &mut [f32], work: &mut Workspace<M::Work>) {
        self.message.show(rows(self.normalised(x, &mut work.h)), shown);
    }

    fn normalised<'h>(&self, x: &[f32], h: &'h mut Vec<f32>) -> &'h [f32] {
        resize(h, x.len());
        self.norm1.apply(x, h);
        h
    }

    /// What the message needs of the anchors' own features.
    fn own_features<'h>(&self, x: &[f32], h: &'h mut Vec<f32>) -> &'h [f32] {
        if M::READS_OWN { self.normalised(x, h) } else { &[] }
    }

    /// Replaces the rows of a block by the layer's output.
    pub(super) fn forward(
        &self,
        (all, first): (All<'_>, usize),
        x: &mut [f32],
        mut record: Option<&mut Record>,
        work: &mut Workspace<M::Work>,
    ) {
        let anchors = Anchors { all, first, count: x.len() / WIDTH, h: self.own_features(x, &mut work.h) };
        let maxima = record.as_mut().map(|record| &mut record.maxima);
        self.message.add(anchors, x, maxima, &mut work.message);
        resize(&mut work.normal, x.len());
        self.norm2.apply(x, &mut work.normal);
        let kept = record.filter(|_| M::KEEPS_HIDDEN).map(|record| {
            record.residual.clear();
            record.residual.extend_from_slice(x);
            &mut record.hidden
        });
        self.perceptron.add(rows(&work.normal), x, &mut work.hidden, kept);
    }

    /// Replaces the gradient of a block's output by that of its input, but for what comes through what the block shows.
    pub(super) fn backward(
        &self,
        (all, first): (All<'_>, usize),
        x: &[f32],
        grad: &mut [f32],
        (record, sent): (&Record, &mut M::Sent),
        sums: &mut Sums<'_>,
        work: &mut Workspace<M::Work>,
    ) {
        let Workspace { h, residual, normal, grad_normal, hidden, message } = work;
        let anchors = Anchors { all, first, count: x.len() / WIDTH, h: self.own_features(x, h) };
        let (residual, kept) = if M::KEEPS_HIDDEN {
            (&record.residual, Some(record.hidden.as_slice()))
        } else {
            residual.clear();
            residual.extend_from_slice(x);
            self.message.add_again(anchors, residual, &record.maxima, message);
            (&*residual, None)
        };
        resize(normal, x.len());
        self.norm2.apply(residual, normal);
        resize(grad_normal, x.len());
        self.perceptron.backward((rows(normal), kept), rows(grad), grad_normal, sums, hidden);
        self.norm2.backward(residual, grad_normal, grad, sums);
        if M::READS_OWN {
            zero(grad_normal, x.len());
        }
        self.message.backward(anchors, &record.maxima, grad, grad_normal, sent, sums, message);
        if M::READS_OWN {
            self.norm1.backward(x, grad_normal, grad, sums);
        }
    }

    /// Adds to the gradient of the input of rows what comes through what they show.
    pub(super) fn shown_backward(
        &self,
        (all, first): (All<'_>, usize),
        x: &[f32],
        grad: &mut [f32],
        kept: Kept<'_, M::Sent>,
        sums: &mut Sums<'_>,
        work: &mut Workspace<M::Work>,
    ) {
        let Workspace { h, grad_normal, message, .. } = work;
        let anchors = Anchors { all, first, count: x.len() / WIDTH, h: self.normalised(x, h) };
        zero(grad_normal, x.len());
        self.message.shown_backward(anchors, kept, grad_normal, sums, message);
        self.norm1.backward(x, grad_normal, grad, sums);
    }
}
