//! What an anchor learns from itself and its neighbours in a layer: all that the kinds of head differ in.

use super::maximum::Maxima;
use super::network::BLOCK;
use super::sums::Sums;
use super::transpose::Lookers;
use crate::{Inputs, Layout, WIDTH};
use cpu_kernels::{Isa, Rows};

/// A row of features.
pub(super) type Row = [f32; WIDTH];

/// All anchors: who sees whom, and what each shows.
#[derive(Debug, Clone, Copy)]
pub(super) struct All<'a> {
    pub(super) inputs: &'a Inputs<'a>,
    /// `[n, Message::SHOWN]`.
    pub(super) shown: &'a [f32],
}

/// A block of anchors among all.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchors<'a> {
    pub(super) all: All<'a>,
    pub(super) first: usize,
    pub(super) count: usize,
    /// Their normalised features; empty where [`Message::READS_OWN`] is false and nothing is shown.
    pub(super) h: &'a [f32],
}

impl<'a> Anchors<'a> {
    pub(super) fn h(&self) -> Rows<'a> {
        rows(self.h)
    }
}

/// What a block keeps of a layer's forward pass for the gradient.
#[derive(Debug, Clone, Default)]
pub(super) struct Record {
    /// Empty of kinds without a maximum.
    pub(super) maxima: Maxima,
    /// Features after the message, `[rows, 128]`; empty unless [`Message::KEEPS_HIDDEN`].
    pub(super) residual: Vec<f32>,
    /// What the perceptron activates, `[rows, hidden]`; empty unless [`Message::KEEPS_HIDDEN`].
    pub(super) hidden: Vec<f32>,
}

/// What the blocks have kept for the gradient of what is shown.
#[derive(Debug)]
pub(super) struct Kept<'a, Sent> {
    pub(super) lookers: &'a Lookers,
    /// One for each block.
    pub(super) records: &'a [Record],
    /// One for each block.
    pub(super) sent: &'a [Sent],
}

impl<'a, Sent> Kept<'a, Sent> {
    /// What the block of an anchor has kept.
    #[inline(always)]
    pub(super) fn sent_by(&self, anchor: usize) -> &'a Sent {
        &self.sent[anchor / BLOCK]
    }

    /// The same of the forward pass.
    #[inline(always)]
    pub(super) fn maxima_of(&self, anchor: usize) -> &'a Maxima {
        &self.records[anchor / BLOCK].maxima
    }
}

impl<Sent> Clone for Kept<'_, Sent> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Sent> Copy for Kept<'_, Sent> {}

/// The message of one kind of head. What depends on one anchor alone is computed once, and shown to all that look at it.
pub(super) trait Message<'a>: Sized + Sync {
    /// Numbers that an anchor shows.
    const SHOWN: usize;

    /// Memory for a block of anchors.
    type Work: Default;

    /// What a block keeps until all blocks have been gone over: the gradient of what an anchor shows is a sum over those
    /// that look at it.
    type Sent: Default + Send + Sync;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self;

    /// What anchors with the normalised features `h` show.
    fn show(&self, h: Rows<'_>, shown: &mut [f32]);

    /// Whether anchors look at their neighbours.
    const LOOKS: bool = true;

    /// Whether a message depends on the anchor's own features but for what it shows.
    const READS_OWN: bool = true;

    /// Whether the tape keeps what the perceptrons activate, so that the gradient does not compute it again. Worth its memory
    /// where messages are cheap; elsewhere they are most of what is computed again.
    const KEEPS_HIDDEN: bool = false;

    /// Replaces what all anchors show by what others see of it. The default leaves it unchanged.
    fn share(_inputs: &Inputs<'_>, _shown: &mut [f32]) {}

    /// Adds the messages to the rows `y`. `maxima`, if asked for, are to be the block's.
    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], maxima: Option<&mut Maxima>, work: &mut Self::Work);

    /// The same, given the maxima.
    fn add_again(&self, anchors: Anchors<'_>, y: &mut [f32], _maxima: &Maxima, work: &mut Self::Work) {
        self.add(anchors, y, None, work);
    }

    /// From the gradient of the messages adds to `grad_h` all but what comes through what is shown. `work` is as
    /// `add_again` left it.
    fn backward(
        &self,
        anchors: Anchors<'_>,
        maxima: &Maxima,
        grad: &[f32],
        grad_h: &mut [f32],
        sent: &mut Self::Sent,
        sums: &mut Sums<'_>,
        work: &mut Self::Work,
    );

    /// The transpose of [`share`](Self::share): turns the gradients of what is seen, which all blocks have kept, into those of what is
    /// shown.
    fn return_sent(_inputs: &Inputs<'_>, _sent: &mut [Self::Sent]) {}

    /// Adds to `grad_h` what comes through what the anchors show.
    fn shown_backward(
        &self,
        anchors: Anchors<'_>,
        kept: Kept<'_, Self::Sent>,
        grad_h: &mut [f32],
        sums: &mut Sums<'_>,
        work: &mut Self::Work,
    );
}

/// Sets the length; the values are to be overwritten.
pub(super) fn resize<T: Clone + Default>(values: &mut Vec<T>, len: usize) {
    values.resize(len, T::default());
}

pub(super) fn zero(values: &mut Vec<f32>, len: usize) {
    values.clear();
    values.resize(len, 0.0);
}

pub(super) fn rows(values: &[f32]) -> Rows<'_> {
    Rows::new(values, values.len() / WIDTH, WIDTH)
}

pub(super) fn each(values: &[f32]) -> &[Row] {
    values.as_chunks().0
}

pub(super) fn each_mut(values: &mut [f32]) -> &mut [Row] {
    values.as_chunks_mut().0
}
