//! One block of the network: attention over neighbours, then a perceptron, each with a residual.

use super::linear::Linear;
use super::norm::Norm;
use super::pairs::{self, ByHead, Row, TwoRows};
use super::perceptron::{Hidden, Perceptron};
use super::sums::{Place, Sums};
use crate::{HEAD_WIDTH, HEADS, Inputs, Layout, WIDTH};
use cpu_kernels::rows as each_row;
use cpu_kernels::{Activation, Isa, Packed, Rows, multiply, multiply_transposed};

/// Parameters of a layer, ready for products.
#[derive(Debug)]
pub(super) struct Layer<'a> {
    pub(super) isa: Isa,
    norm1: Norm<'a>,
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
    norm2: Norm<'a>,
    perceptron: Perceptron<'a>,
}

/// Memory for a block of anchors.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    normal: Vec<f32>,
    query: Vec<f32>,
    up: Vec<f32>,
    gathered: Vec<f32>,
    mixed: Vec<f32>,
    residual: Vec<f32>,
    grad_normal: Vec<f32>,
    grad_mixed: Vec<f32>,
    grad_query: Vec<f32>,
    grad_up: Vec<f32>,
    grad_gathered: Vec<f32>,
    pub(super) hidden: Hidden,
    pairs: pairs::Scratch,
}

/// A block of anchors and what they may look at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchors<'a> {
    pub(super) first: usize,
    pub(super) inputs: &'a Inputs<'a>,
    pub(super) keys_values: &'a [TwoRows],
}

/// What is kept of a block until all blocks have been gone over: the gradients of keys and values are sums over
/// those who look at them.
#[derive(Debug)]
pub(super) struct Sent<'a> {
    /// `[rows, k + 1]`.
    pub(super) alphas: &'a mut [[f32; HEADS]],
    /// Gradients of the logits, `[rows, k + 1]`.
    pub(super) logits: &'a mut [[f32; HEADS]],
    /// The scaled query, and the gradient of the weighted sum of values.
    pub(super) rows: &'a mut [TwoRows],
}

/// 1 / sqrt(width of a head).
const SCALE: f32 = 0.176_776_7;

impl<'a> Layer<'a> {
    pub(super) fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let linear = |part: &str| Linear::new(isa, layout, values, &format!("{name}.{part}"));
        let norm = |part: &str| Norm::new(isa, layout, values, &format!("{name}.{part}"));
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
            norm1: norm("norm1"),
            query: linear("attn.q"),
            key: linear("attn.k"),
            value: linear("attn.v"),
            offset,
            offset_at,
            up: std::array::from_fn(|c| Packed::rows(isa, of_head(c))),
            down: std::array::from_fn(|c| Packed::transposed(isa, of_head(c))),
            down_bias: down_at.1.of(values),
            down_at,
            project: linear("attn.proj"),
            norm2: norm("norm2"),
            perceptron: Perceptron::new(isa, layout, values, &format!("{name}.ffn"), Activation::Gelu),
        }
    }

    /// Keys and values of rows.
    pub(super) fn keys_values(&self, x: &[f32], out: &mut [f32], work: &mut Workspace) {
        resize(&mut work.normal, x.len());
        self.norm1.apply(x, &mut work.normal);
        let normal = rows(&work.normal);
        self.key.apply(normal, out, 2 * WIDTH);
        self.value.apply(normal, &mut out[WIDTH..], 2 * WIDTH);
    }

    /// Replaces the rows of a block by the layer's output.
    pub(super) fn forward(
        &self,
        anchors: Anchors<'_>,
        x: &mut [f32],
        alphas: &mut [[f32; HEADS]],
        work: &mut Workspace,
    ) {
        self.attend(anchors, x, alphas, work);
        x.copy_from_slice(&work.residual);
        resize(&mut work.normal, x.len());
        self.norm2.apply(x, &mut work.normal);
        self.perceptron.add(rows(&work.normal), x, &mut work.hidden);
    }

    /// Everything up to the first residual, kept in `work`.
    fn attend(&self, anchors: Anchors<'_>, x: &[f32], alphas: &mut [[f32; HEADS]], work: &mut Workspace) {
        for part in [&mut work.normal, &mut work.query, &mut work.mixed] {
            resize(part, x.len());
        }
        for part in [&mut work.up, &mut work.gathered] {
            resize(part, HEADS * x.len());
        }
        self.norm1.apply(x, &mut work.normal);
        self.query.apply(rows(&work.normal), &mut work.query, WIDTH);
        work.query.iter_mut().for_each(|q| *q *= SCALE);
        self.go_up(&work.query, &mut work.up);
        let block = self.block(anchors, &work.query, &work.up);
        pairs::attend(
            &block,
            alphas,
            by_head_mut(&mut work.gathered),
            each_mut(&mut work.mixed),
            &mut work.pairs,
        );
        each_row::add_to_each(self.isa, &mut work.mixed, self.down_bias);
        self.go_down(&work.gathered, &mut work.mixed);
        work.residual.clear();
        work.residual.extend_from_slice(x);
        self.project.add(rows(&work.mixed), &mut work.residual);
    }

    /// Replaces the gradient of a block's output by that of its input, but for what comes through keys and values.
    pub(super) fn backward(
        &self,
        anchors: Anchors<'_>,
        x: &[f32],
        grad: &mut [f32],
        sent: &mut Sent<'_>,
        sums: &mut Sums<'_>,
        work: &mut Workspace,
    ) {
        self.attend(anchors, x, sent.alphas, work);
        let size = x.len();
        let Workspace { normal, grad_normal, hidden, .. } = work;
        // Perceptron and its residual.
        resize(normal, size);
        self.norm2.apply(&work.residual, normal);
        zero(grad_normal, size);
        self.perceptron.backward(rows(normal), rows(grad), grad_normal, sums, hidden);
        self.norm2.backward(&work.residual, grad_normal, grad, sums);
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
        let mut offset = [[0.0; WIDTH]; 4];
        let gradient = pairs::Gradient {
            alphas: sent.alphas,
            mixed: each(grad_mixed),
            gathered: by_head(&work.grad_gathered),
            logits: sent.logits,
            up: by_head_mut(&mut work.grad_up),
            query: each_mut(&mut work.grad_query),
            offset: &mut offset,
        };
        pairs::attend_backward(&self.block(anchors, &work.query, &work.up), gradient, &mut work.pairs);
        let [columns @ .., bias] = &offset;
        for (i, column) in columns.iter().enumerate() {
            let sum = sums.at(self.offset_at.0).iter_mut().skip(i).step_by(3);
            sum.zip(column).for_each(|(sum, v)| *sum += v);
        }
        sums.add(self.offset_at.1, bias);
        // W₂, which takes queries up and sums down.
        for c in 0..HEADS {
            let part = c * HEAD_WIDTH * WIDTH..(c + 1) * HEAD_WIDTH * WIDTH;
            let sum = &mut sums.at(self.down_at.0)[part];
            let of_head = |x| rows(x).columns(c * HEAD_WIDTH, HEAD_WIDTH);
            multiply_transposed(self.isa, of_head(&*grad_mixed), head(&work.gathered, c), sum);
            multiply_transposed(self.isa, of_head(&work.query), head(&work.grad_up, c), sum);
        }
        for ((sent, query), grad_mixed) in sent.rows.iter_mut().zip(each(&work.query)).zip(each(grad_mixed)) {
            sent[..WIDTH].copy_from_slice(query);
            sent[WIDTH..].copy_from_slice(grad_mixed);
        }
        // Queries.
        self.go_down(&work.grad_up, &mut work.grad_query);
        work.grad_query.iter_mut().for_each(|q| *q *= SCALE);
        self.norm1.apply(x, normal);
        self.query.weight_gradient(rows(normal), rows(&work.grad_query), sums);
        zero(grad_normal, size);
        self.query.input_gradient(rows(&work.grad_query), grad_normal);
        self.norm1.backward(x, grad_normal, grad, sums);
    }

    /// Adds to the gradient of the input of rows what comes through their keys and values.
    pub(super) fn keys_values_backward(
        &self,
        x: &[f32],
        grad_keys_values: &[TwoRows],
        grad: &mut [f32],
        sums: &mut Sums<'_>,
        work: &mut Workspace,
    ) {
        let Workspace { normal, grad_normal, .. } = work;
        resize(normal, x.len());
        self.norm1.apply(x, normal);
        zero(grad_normal, x.len());
        let both = Rows::new(grad_keys_values.as_flattened(), grad_keys_values.len(), 2 * WIDTH);
        for (part, linear) in [&self.key, &self.value].into_iter().enumerate() {
            let grad_out = both.columns(part * WIDTH, WIDTH);
            linear.weight_gradient(rows(normal), grad_out, sums);
            linear.input_gradient(grad_out, grad_normal);
        }
        self.norm1.backward(x, grad_normal, grad, sums);
    }

    fn block<'b>(&'b self, anchors: Anchors<'b>, query: &'b [f32], up: &'b [f32]) -> pairs::Block<'b> {
        let Anchors { first, inputs, keys_values } = anchors;
        pairs::Block {
            isa: self.isa,
            first,
            inputs,
            offset: &self.offset,
            keys_values,
            query: each(query),
            up: by_head(up),
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

/// Sets the length; what it holds is to be overwritten.
fn resize(values: &mut Vec<f32>, len: usize) {
    values.resize(len, 0.0);
}

fn zero(values: &mut Vec<f32>, len: usize) {
    values.clear();
    values.resize(len, 0.0);
}

fn rows(values: &[f32]) -> Rows<'_> {
    Rows::new(values, values.len() / WIDTH, WIDTH)
}

/// One head's rows of h_ij.
fn head(values: &[f32], c: usize) -> Rows<'_> {
    Rows::new(values, values.len() / (HEADS * WIDTH), HEADS * WIDTH).columns(c * WIDTH, WIDTH)
}

fn each(values: &[f32]) -> &[Row] {
    values.as_chunks().0
}

fn each_mut(values: &mut [f32]) -> &mut [Row] {
    values.as_chunks_mut().0
}

fn by_head(values: &[f32]) -> &[ByHead] {
    each(values).as_chunks().0
}

fn by_head_mut(values: &mut [f32]) -> &mut [ByHead] {
    each_mut(values).as_chunks_mut().0
}
