//! All parameters, packed for matrix products, and the forward pass.

use super::layer::{Anchors, Layer, Workspace};
use super::norm::Norm;
use super::pairs::TwoRows;
use super::perceptron::Perceptron;
use super::range_rows;
use crate::{Config, HEADS, Inputs, Kind, LAYERS, Layout, OUTPUTS, WIDTH};
use cpu_kernels::{Activation, Isa, Rows};
use rayon::prelude::*;

/// Anchors that are worked on together: what they need stays in the second-level cache, and every weight that is
/// fetched serves all of them.
pub(super) const BLOCK: usize = 48;

/// The parameters.
#[derive(Debug)]
pub(super) struct Network<'a> {
    pub(super) geometry: Perceptron<'a>,
    pub(super) image: Perceptron<'a>,
    pub(super) layers: [Layer<'a>; LAYERS],
    pub(super) norm: Norm<'a>,
    pub(super) out: Perceptron<'a>,
}

impl<'a> Network<'a> {
    pub(super) fn new(config: &Config, layout: &Layout, values: &'a [f32]) -> Self {
        let isa = Isa::in_use();
        assert_eq!(config.kind, Kind::Attention, "the kind of head that the fused form computes");
        assert_eq!(values.len(), layout.len, "numbers in the weights");
        Self {
            geometry: Perceptron::new(isa, layout, values, "phi_g", Activation::Relu),
            image: Perceptron::new(isa, layout, values, "phi_v", Activation::Relu),
            layers: std::array::from_fn(|l| Layer::new(isa, layout, values, &format!("blocks.{l}"))),
            norm: Norm::new(isa, layout, values, "norm"),
            out: Perceptron::new(isa, layout, values, "out", Activation::Gelu),
        }
    }

    /// Outputs `[n, 38]`. `keep` sees the features `[n, 128]` before every layer and after the last.
    pub(super) fn run(&self, config: &Config, inputs: &Inputs<'_>, mut keep: impl FnMut(&[f32])) -> Vec<f32> {
        let mut x = self.embed(config, inputs);
        let mut keys_values = vec![[0.0; 2 * WIDTH]; inputs.n];
        for layer in &self.layers {
            keep(&x);
            keys_values_of(layer, &x, &mut keys_values);
            forward(layer, inputs, &keys_values, &mut x);
        }
        keep(&x);
        drop(keys_values);
        self.attributes(inputs.n, &x)
    }

    fn embed(&self, config: &Config, inputs: &Inputs<'_>) -> Vec<f32> {
        let mut x = vec![0.0; inputs.n * WIDTH];
        let (geometry, image) = embedded(config, inputs);
        let rows = range_rows(inputs.n);
        x.par_chunks_mut(rows * WIDTH).enumerate().for_each(|(range, x)| {
            let mut work = Workspace::default();
            for (block, x) in x.chunks_mut(BLOCK * WIDTH).enumerate() {
                let first = range * rows + block * BLOCK;
                let here = first..first + x.len() / WIDTH;
                self.geometry.apply(geometry.slice(here.clone()), x, WIDTH, &mut work.hidden);
                self.image.apply(image.slice(here), &mut x[WIDTH / 2..], WIDTH, &mut work.hidden);
            }
        });
        x
    }

    fn attributes(&self, n: usize, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; n * OUTPUTS];
        let rows = range_rows(n);
        let ranges = out.par_chunks_mut(rows * OUTPUTS).zip(x.par_chunks(rows * WIDTH));
        ranges.for_each(|(out, x)| {
            let (mut work, mut normal) = (Workspace::default(), [0.0; BLOCK * WIDTH]);
            for (out, x) in out.chunks_mut(BLOCK * OUTPUTS).zip(x.chunks(BLOCK * WIDTH)) {
                let normal = &mut normal[..x.len()];
                self.norm.apply(x, normal);
                let normal = Rows::new(normal, x.len() / WIDTH, WIDTH);
                self.out.apply(normal, out, OUTPUTS, &mut work.hidden);
            }
        });
        out
    }
}

/// Inputs of the two embeddings.
pub(super) fn embedded<'a>(config: &Config, inputs: &Inputs<'a>) -> (Rows<'a>, Rows<'a>) {
    (Rows::new(inputs.geometry, inputs.n, config.geometry), Rows::new(inputs.image, inputs.n, config.image))
}

/// Keys and values of all anchors.
pub(super) fn keys_values_of(layer: &Layer<'_>, x: &[f32], out: &mut [TwoRows]) {
    let rows = range_rows(out.len());
    out.par_chunks_mut(rows).zip(x.par_chunks(rows * WIDTH)).for_each(|(out, x)| {
        let mut work = Workspace::default();
        for (out, x) in out.chunks_mut(BLOCK).zip(x.chunks(BLOCK * WIDTH)) {
            layer.keys_values(x, out.as_flattened_mut(), &mut work);
        }
    });
}

fn forward(layer: &Layer<'_>, inputs: &Inputs<'_>, keys_values: &[TwoRows], x: &mut [f32]) {
    let rows = range_rows(inputs.n);
    x.par_chunks_mut(rows * WIDTH).enumerate().for_each(|(range, x)| {
        let mut work = Workspace::default();
        let mut alphas = vec![[0.0; HEADS]; BLOCK * (inputs.k + 1)];
        for (block, x) in x.chunks_mut(BLOCK * WIDTH).enumerate() {
            let anchors = Anchors { first: range * rows + block * BLOCK, inputs, keys_values };
            let alphas = &mut alphas[..x.len() / WIDTH * (inputs.k + 1)];
            layer.forward(anchors, x, alphas, &mut work);
        }
    });
}
