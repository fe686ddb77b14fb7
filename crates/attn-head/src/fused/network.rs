//! All parameters, packed for matrix products, and the forward pass.

use super::layer::{Layer, Workspace};
use super::message::{All, Message, Record};
use super::norm::Norm;
use super::perceptron::{Hidden, Perceptron};
use super::{Tape, range_rows, zeros};
use crate::{Config, Inputs, Layout, OUTPUTS, WIDTH};
use cpu_kernels::{Activation, Isa, Rows};
use rayon::prelude::*;

/// Anchors that are worked on together: what they need stays in the second-level cache, and every weight that is
/// fetched serves all of them.
pub(super) const BLOCK: usize = 96;

/// The parameters.
#[derive(Debug)]
pub(super) struct Network<'a, M> {
    pub(super) geometry: Perceptron<'a>,
    pub(super) image: Perceptron<'a>,
    pub(super) layers: Vec<Layer<'a, M>>,
    pub(super) norm: Norm<'a>,
    pub(super) out: Perceptron<'a>,
}

impl<'a, M: Message<'a>> Network<'a, M> {
    pub(super) fn new(config: &Config, layout: &Layout, values: &'a [f32]) -> Self {
        let isa = Isa::in_use();
        assert_eq!(values.len(), layout.len, "numbers in the weights");
        Self {
            geometry: Perceptron::new(isa, layout, values, "phi_g", Activation::Relu),
            image: Perceptron::new(isa, layout, values, "phi_v", Activation::Relu),
            layers: (0..config.kind.layers())
                .map(|l| Layer::new(isa, layout, values, &format!("blocks.{l}")))
                .collect(),
            norm: Norm::new(isa, layout, values, "norm"),
            out: Perceptron::new(isa, layout, values, "out", Activation::Gelu),
        }
    }

    /// Outputs `[n, 38]`; `tape` is filled if there is one.
    pub(super) fn run(&self, config: &Config, inputs: &Inputs<'_>, mut tape: Option<&mut Tape>) -> Vec<f32> {
        let mut x = self.embed(config, inputs);
        let blocks = inputs.n.div_ceil(BLOCK);
        let mut shown = Vec::new();
        for layer in &self.layers {
            let mut records = vec![Record::default(); blocks];
            if shown.is_empty() {
                shown = zeros(inputs.n * M::SHOWN);
            }
            show(layer, inputs, &x, &mut shown);
            let all = All { inputs, shown: &shown };
            if let Some(tape) = &mut tape {
                let before = std::mem::replace(&mut x, vec![0.0; inputs.n * WIDTH]);
                forward(layer, all, Some(&before), &mut x, (&mut records, true));
                tape.features.push(before);
                tape.records.push(records);
                if M::KEEPS_HIDDEN {
                    tape.shown.push(std::mem::take(&mut shown));
                }
            } else {
                forward(layer, all, None, &mut x, (&mut records, false));
            }
        }
        drop(shown);
        let mut kept = vec![Vec::new(); blocks];
        let out = self.attributes(&x, &mut kept, M::KEEPS_HIDDEN && tape.is_some());
        if let Some(tape) = tape {
            tape.features.push(x);
            tape.last = kept;
        }
        out
    }

    fn embed(&self, config: &Config, inputs: &Inputs<'_>) -> Vec<f32> {
        let mut x = zeros(inputs.n * WIDTH);
        let (geometry, image) = embedded(config, inputs);
        let rows = range_rows(inputs.n);
        x.par_chunks_mut(rows * WIDTH).enumerate().for_each(|(range, x)| {
            let mut hidden = Hidden::default();
            for (block, x) in x.chunks_mut(BLOCK * WIDTH).enumerate() {
                let first = range * rows + block * BLOCK;
                let here = first..first + x.len() / WIDTH;
                self.geometry.apply(geometry.slice(here.clone()), x, WIDTH, &mut hidden, None);
                self.image.apply(image.slice(here), &mut x[WIDTH / 2..], WIDTH, &mut hidden, None);
            }
        });
        x
    }

    /// Of each block `kept` gets what the perceptron activates if that is to be recorded.
    fn attributes(&self, x: &[f32], kept: &mut [Vec<f32>], record: bool) -> Vec<f32> {
        let n = x.len() / WIDTH;
        let mut out = zeros(n * OUTPUTS);
        let rows = range_rows(n);
        let ranges = out.par_chunks_mut(rows * OUTPUTS).zip(x.par_chunks(rows * WIDTH));
        ranges.zip(kept.par_chunks_mut(rows / BLOCK)).for_each(|((out, x), kept)| {
            let (mut hidden, mut normal) = (Hidden::default(), [0.0; BLOCK * WIDTH]);
            let blocks = out.chunks_mut(BLOCK * OUTPUTS).zip(x.chunks(BLOCK * WIDTH));
            for ((out, x), kept) in blocks.zip(kept) {
                let normal = &mut normal[..x.len()];
                self.norm.apply(x, normal);
                let normal = Rows::new(normal, x.len() / WIDTH, WIDTH);
                self.out.apply(normal, out, OUTPUTS, &mut hidden, record.then_some(kept));
            }
        });
        out
    }
}

/// Inputs of the two embeddings.
pub(super) fn embedded<'a>(config: &Config, inputs: &Inputs<'a>) -> (Rows<'a>, Rows<'a>) {
    (Rows::new(inputs.geometry, inputs.n, config.geometry), Rows::new(inputs.image, inputs.n, config.image))
}

/// What all anchors show to those that look at them.
pub(super) fn show<'a, M: Message<'a>>(
    layer: &Layer<'a, M>,
    inputs: &Inputs<'_>,
    x: &[f32],
    shown: &mut [f32],
) {
    let rows = range_rows(x.len() / WIDTH);
    shown.par_chunks_mut(rows * M::SHOWN).zip(x.par_chunks(rows * WIDTH)).for_each(|(shown, x)| {
        let mut work = Workspace::default();
        for (shown, x) in shown.chunks_mut(BLOCK * M::SHOWN).zip(x.chunks(BLOCK * WIDTH)) {
            layer.show(x, shown, &mut work);
        }
    });
    M::share(inputs, shown);
}

/// A layer on the features `x`, or on those `before`. The blocks' records are filled if they are to be.
fn forward<'a, M: Message<'a>>(
    layer: &Layer<'a, M>,
    all: All<'_>,
    before: Option<&[f32]>,
    x: &mut [f32],
    (records, record): (&mut [Record], bool),
) {
    let rows = range_rows(all.inputs.n);
    let ranges = x.par_chunks_mut(rows * WIDTH).zip(records.par_chunks_mut(rows / BLOCK));
    ranges.enumerate().for_each(|(range, (x, records))| {
        let mut work = Workspace::default();
        for (block, (x, kept)) in x.chunks_mut(BLOCK * WIDTH).zip(records).enumerate() {
            let first = range * rows + block * BLOCK;
            if let Some(before) = before {
                x.copy_from_slice(&before[first * WIDTH..][..x.len()]);
            }
            layer.forward((all, first), x, record.then_some(kept), &mut work);
        }
    });
}
