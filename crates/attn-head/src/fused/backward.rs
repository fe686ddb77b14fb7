//! Gradients, layer by layer from the last to the first.

use super::layer::{Anchors, Layer, Sent, Workspace};
use super::network::{BLOCK, Network, embedded, keys_values_of};
use super::pairs::TwoRows;
use super::sums::{Sums, span};
use super::transpose::{AllSent, Lookers, gather};
use super::{Gradients, Tape, range_rows};
use crate::{Config, HEADS, Inputs, Layout, OUTPUTS, WIDTH};
use cpu_kernels::Rows;
use rayon::prelude::*;
use std::ops::Range;

/// The gradients of one call.
pub(super) struct Backward<'a> {
    pub(super) config: &'a Config,
    pub(super) layout: &'a Layout,
    pub(super) network: &'a Network<'a>,
    pub(super) inputs: &'a Inputs<'a>,
}

/// What a layer keeps for all anchors.
struct Buffers {
    keys_values: Vec<TwoRows>,
    alphas: Vec<[f32; HEADS]>,
    logits: Vec<[f32; HEADS]>,
    rows: Vec<TwoRows>,
}

impl Backward<'_> {
    pub(super) fn run(&self, tape: &Tape, grad_out: &[f32]) -> Gradients {
        let Inputs { n, k, .. } = *self.inputs;
        let mut weights = vec![0.0; self.layout.len];
        let mut grad = vec![0.0; n * WIDTH];
        let (last, layers) = tape.features.split_last().expect("features before and after layers");
        self.attributes(last, grad_out, &mut grad, &mut weights);
        let lookers = Lookers::new(self.inputs);
        let mut buffers = Buffers {
            keys_values: vec![[0.0; 2 * WIDTH]; n],
            alphas: vec![[0.0; HEADS]; n * (k + 1)],
            logits: vec![[0.0; HEADS]; n * (k + 1)],
            rows: vec![[0.0; 2 * WIDTH]; n],
        };
        for (l, (layer, x)) in self.network.layers.iter().zip(layers).enumerate().rev() {
            let span = span(self.layout, &format!("blocks.{l}."));
            self.layer((layer, x), &mut grad, &lookers, &mut buffers, (span, &mut weights));
        }
        drop(buffers);
        let (geometry, image) = self.embedding(&grad, &mut weights);
        Gradients { weights, geometry, image }
    }

    fn layer(
        &self,
        (layer, x): (&Layer<'_>, &[f32]),
        grad: &mut [f32],
        lookers: &Lookers,
        buffers: &mut Buffers,
        (span, weights): (Range<usize>, &mut [f32]),
    ) {
        let (inputs, pairs) = (self.inputs, self.inputs.k + 1);
        let rows = range_rows(inputs.n);
        let Buffers { keys_values, alphas, logits, rows: sent } = buffers;
        keys_values_of(layer, x, keys_values);
        summed(span.clone(), weights, inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(x.par_chunks(rows * WIDTH));
            let kept = alphas.par_chunks_mut(rows * pairs).zip(logits.par_chunks_mut(rows * pairs));
            let kept = kept.zip(sent.par_chunks_mut(rows)).zip(partial);
            ranges.zip(kept).enumerate().for_each(
                |(range, ((grad, x), (((alphas, logits), sent), mut sums)))| {
                    let mut work = Workspace::default();
                    let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                    let kept = alphas.chunks_mut(BLOCK * pairs).zip(logits.chunks_mut(BLOCK * pairs));
                    let kept = kept.zip(sent.chunks_mut(BLOCK));
                    for (block, ((grad, x), ((alphas, logits), rows_sent))) in blocks.zip(kept).enumerate() {
                        let anchors = Anchors { first: range * rows + block * BLOCK, inputs, keys_values };
                        let mut sent = Sent { alphas, logits, rows: rows_sent };
                        layer.backward(anchors, x, grad, &mut sent, &mut sums, &mut work);
                    }
                },
            );
        });
        let sent = AllSent { alphas, logits, rows: sent };
        summed(span, weights, inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(x.par_chunks(rows * WIDTH)).zip(partial);
            ranges.enumerate().for_each(|(range, ((grad, x), mut sums))| {
                let mut work = Workspace::default();
                let mut gathered = vec![[0.0; 2 * WIDTH]; BLOCK];
                let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                for (block, (grad, x)) in blocks.enumerate() {
                    let gathered = &mut gathered[..x.len() / WIDTH];
                    gather(layer.isa, sent, lookers, range * rows + block * BLOCK, gathered);
                    layer.keys_values_backward(x, gathered, grad, &mut sums, &mut work);
                }
            });
        });
    }

    /// The perceptron at the end: adds to the gradient of the features.
    fn attributes(&self, x: &[f32], grad_out: &[f32], grad: &mut [f32], weights: &mut [f32]) {
        let (norm, out) = (span(self.layout, "norm."), span(self.layout, "out."));
        let rows = range_rows(self.inputs.n);
        summed(norm.start.min(out.start)..norm.end.max(out.end), weights, self.inputs.n, |partial| {
            let ranges = grad.par_chunks_mut(rows * WIDTH).zip(x.par_chunks(rows * WIDTH));
            let ranges = ranges.zip(grad_out.par_chunks(rows * OUTPUTS)).zip(partial);
            ranges.for_each(|(((grad, x), grad_out), mut sums)| {
                let mut work = Workspace::default();
                let (mut normal, mut grad_normal) = (Vec::new(), Vec::new());
                let blocks = grad.chunks_mut(BLOCK * WIDTH).zip(x.chunks(BLOCK * WIDTH));
                for ((grad, x), grad_out) in blocks.zip(grad_out.chunks(BLOCK * OUTPUTS)) {
                    normal.resize(x.len(), 0.0);
                    self.network.norm.apply(x, &mut normal);
                    grad_normal.clear();
                    grad_normal.resize(x.len(), 0.0);
                    let count = x.len() / WIDTH;
                    self.network.out.backward(
                        Rows::new(&normal, count, WIDTH),
                        Rows::new(grad_out, count, OUTPUTS),
                        &mut grad_normal,
                        &mut sums,
                        &mut work.hidden,
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
                    let Workspace { mut hidden, .. } = Workspace::default();
                    for (block, grad_x) in grad_x.chunks_mut(BLOCK * width).enumerate() {
                        let first = range * rows + block * BLOCK;
                        let here = first..first + grad_x.len() / width;
                        let grad_out = grad.slice(here.clone()).columns(column, WIDTH / 2);
                        perceptron.backward(x.slice(here), grad_out, grad_x, &mut sums, &mut hidden);
                    }
                });
            });
            grad_x
        });
        (geometry, image)
    }
}

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
    let total = &mut weights[span];
    for partial in partial.chunks(total.len()) {
        total.iter_mut().zip(partial).for_each(|(sum, v)| *sum += v);
    }
}
