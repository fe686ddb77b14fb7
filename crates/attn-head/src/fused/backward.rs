//! Gradients, layer by layer from the last to the first.

use super::layer::{Layer, Workspace};
use super::message::{All, Kept, Message, Record, resize};
use super::network::{BLOCK, Network, embedded, show};
use super::perceptron::Hidden;
use super::sums::{Sums, span};
use super::transpose::Lookers;
use super::{Gradients, Tape, range_rows};
use crate::{Config, Inputs, Layout, OUTPUTS, WIDTH};
use cpu_kernels::Rows;
use rayon::prelude::*;
use std::ops::Range;

/// The gradients of one call.
pub(super) struct Backward<'b, 'a, M> {
    pub(super) config: &'b Config,
    pub(super) layout: &'b Layout,
    pub(super) network: &'b Network<'a, M>,
    pub(super) inputs: &'b Inputs<'b>,
}

impl<'a, M: Message<'a>> Backward<'_, 'a, M> {
    pub(super) fn run(&self, tape: &Tape, grad_out: &[f32]) -> Gradients {
        let n = self.inputs.n;
        let mut weights = vec![0.0; self.layout.len];
        let mut grad = vec![0.0; n * WIDTH];
        let (last, layers) = tape.features.split_last().expect("features before and after layers");
        self.attributes((last, &tape.last), grad_out, &mut grad, &mut weights);
        let nobody = Inputs { k: 0, neighbours: &[], relative: &[], ..*self.inputs };
        let lookers = Lookers::new(if M::LOOKS { self.inputs } else { &nobody });
        let mut again = Vec::new();
        let mut sent: Vec<M::Sent> = (0..n.div_ceil(BLOCK)).map(|_| M::Sent::default()).collect();
        let recorded = layers.iter().zip(&tape.records);
        for (l, (layer, (x, records))) in self.network.layers.iter().zip(recorded).enumerate().rev() {
            let shown = if M::KEEPS_HIDDEN {
                &tape.shown[l]
            } else {
                resize(&mut again, n * M::SHOWN);
                show(layer, self.inputs, x, &mut again);
                &again
            };
            let range = |part: &str| span(self.layout, &format!("blocks.{l}.{part}"));
            let step = Step { layer, all: All { inputs: self.inputs, shown }, x, records };
            step.own(&mut grad, &mut sent, (range(""), &mut weights));
            M::return_sent(self.inputs, &mut sent);
            // The second step has no part in the weights from `norm2` on.
            let kept = Kept { lookers: &lookers, records, sent: &sent };
            step.shown(&mut grad, kept, (range("norm1.").start..range("norm2.").start, &mut weights));
        }
        drop((again, sent));
        let (geometry, image) = self.embedding(&grad, &mut weights);
        Gradients { weights, geometry, image }
    }

    /// The perceptron at the end: adds to the gradient of the features.
    fn attributes(
        &self,
        (x, kept): (&[f32], &[Vec<f32>]),
        grad_out: &[f32],
        grad: &mut [f32],
        weights: &mut [f32],
    ) {
        let (norm, out) = (span(self.layout, "norm."), span(self.layout, "out."));
        let rows = range_rows(self.inputs.n);
        summed(norm.start.min(out.start)..norm.end.max(out.end), weights, self.inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(x.par_chunks(rows * WIDTH));
            let outputs = grad_out.par_chunks(rows * OUTPUTS).zip(kept.par_chunks(rows / BLOCK));
            let ranges = ranges.zip(outputs).zip(partial);
            ranges.for_each(|(((grad, x), (grad_out, kept)), mut sums)| {
                let mut hidden = Hidden::default();
                let (mut normal, mut grad_normal) = (Vec::new(), Vec::new());
                let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                for ((grad, x), (grad_out, kept)) in blocks.zip(grad_out.chunks(BLOCK * OUTPUTS).zip(kept)) {
                    resize(&mut normal, x.len());
                    self.network.norm.apply(x, &mut normal);
                    resize(&mut grad_normal, x.len());
                    let count = x.len() / WIDTH;
                    self.network.out.backward(
                        (Rows::new(&normal, count, WIDTH), M::KEEPS_HIDDEN.then_some(kept)),
                        Rows::new(grad_out, count, OUTPUTS),
                        &mut grad_normal,
                        &mut sums,
                        &mut hidden,
                    );
                    self.network.norm.backward(x, &grad_normal, grad, &mut sums);
                }
            });
        });
    }

    /// The two perceptrons at the beginning: gradients of geometry and image.
    fn embedding(&self, grad: &[f32], weights: &mut [f32]) -> (Vec<f32>, Vec<f32>) {
        let n = self.inputs.n;
        let (geometry, image) = embedded(self.config, self.inputs);
        let grad = Rows::new(grad, n, WIDTH);
        let parts = [
            ("phi_g.", &self.network.geometry, geometry, 0),
            ("phi_v.", &self.network.image, image, WIDTH / 2),
        ];
        let [geometry, image] = parts.map(|(name, perceptron, x, column)| {
            let (rows, width) = (range_rows(n), x.width());
            let mut grad_x = vec![0.0; n * width];
            summed(span(self.layout, name), weights, n, |partial| {
                let ranges = grad_x.par_chunks_mut(rows * width).zip(partial);
                ranges.enumerate().for_each(|(range, (grad_x, mut sums))| {
                    let mut hidden = Hidden::default();
                    for (block, grad_x) in grad_x.chunks_mut(BLOCK * width).enumerate() {
                        let first = range * rows + block * BLOCK;
                        let here = first..first + grad_x.len() / width;
                        let grad_out = grad.slice(here.clone()).columns(column, WIDTH / 2);
                        perceptron.backward((x.slice(here), None), grad_out, grad_x, &mut sums, &mut hidden);
                    }
                });
            });
            grad_x
        });
        (geometry, image)
    }
}

/// A layer's part of the gradients.
struct Step<'s, 'a, M> {
    layer: &'s Layer<'a, M>,
    all: All<'s>,
    x: &'s [f32],
    records: &'s [Record],
}

impl<'a, M: Message<'a>> Step<'_, 'a, M> {
    /// All but what comes through what the anchors show.
    fn own(&self, grad: &mut [f32], sent: &mut [M::Sent], (span, weights): (Range<usize>, &mut [f32])) {
        let rows = range_rows(self.all.inputs.n);
        summed(span, weights, self.all.inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(self.x.par_chunks(rows * WIDTH));
            let kept = self.records.par_chunks(rows / BLOCK).zip(sent.par_chunks_mut(rows / BLOCK));
            let ranges = ranges.zip(kept).zip(partial).enumerate();
            ranges.for_each(|(range, (((grad, x), (records, sent)), mut sums))| {
                let mut work = Workspace::default();
                let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                for (block, ((grad, x), kept)) in blocks.zip(records.iter().zip(sent)).enumerate() {
                    let first = range * rows + block * BLOCK;
                    self.layer.backward((self.all, first), x, grad, kept, &mut sums, &mut work);
                }
            });
        });
    }

    /// What comes through what the anchors show.
    fn shown(&self, grad: &mut [f32], kept: Kept<'_, M::Sent>, (span, weights): (Range<usize>, &mut [f32])) {
        let rows = range_rows(self.all.inputs.n);
        summed(span, weights, self.all.inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(self.x.par_chunks(rows * WIDTH)).zip(partial);
            ranges.enumerate().for_each(|(range, ((grad, x), mut sums))| {
                let mut work = Workspace::default();
                let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                for (block, (grad, x)) in blocks.enumerate() {
                    let first = range * rows + block * BLOCK;
                    self.layer.shown_backward((self.all, first), x, grad, kept, &mut sums, &mut work);
                }
            });
        });
    }
}

/// Numbers of the weights that a task adds up over all ranges.
const SUMMED: usize = 8192;

/// Gradients of the weights in `span`: `work` fills one zeroed sum for each range of anchors, in any order, and they
/// are added up from the first range to the last.
fn summed(
    span: Range<usize>,
    weights: &mut [f32],
    n: usize,
    work: impl FnOnce(rayon::vec::IntoIter<Sums<'_>>),
) {
    let ranges = n.div_ceil(range_rows(n));
    let mut partial = vec![0.0; ranges * span.len()];
    let each: Vec<_> = partial.chunks_mut(span.len()).map(|values| Sums::new(span.start, values)).collect();
    work(each.into_par_iter());
    let len = span.len();
    let total = weights[span].par_chunks_mut(SUMMED);
    total.enumerate().for_each(|(chunk, total)| {
        for partial in partial.chunks(len) {
            let partial = &partial[chunk * SUMMED..][..total.len()];
            total.iter_mut().zip(partial).for_each(|(sum, v)| *sum += v);
        }
    });
}
