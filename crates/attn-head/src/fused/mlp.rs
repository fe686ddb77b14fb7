//! A perceptron of h_i and of 16 numbers from each neighbour, the nearest first.
//!
//! The numbers of a pair are other_j + P (p_j - p_i), and each anchor shows its `other`. An anchor's input takes
//! 128 + 16 k numbers, and is made block by block.

use super::linear::Linear;
use super::maximum::Maxima;
use super::message::{Anchors, Kept, Message, resize};
use super::network::BLOCK;
use super::perceptron::{Hidden, Perceptron};
use super::sums::Sums;
use crate::{Layout, MESSAGE, WIDTH};
use cpu_kernels::{Activation, Isa, Rows};

/// The numbers from a neighbour.
type Heard = [f32; MESSAGE];

/// Parameters of the MLP in a layer.
#[derive(Debug)]
pub(super) struct Mlp<'a> {
    /// The parts for h_j and for p_j - p_i of the neighbours' layer; without neighbours there is none.
    pair: Option<[Linear<'a>; 2]>,
    mix: Perceptron<'a>,
}

#[derive(Debug, Default)]
pub(super) struct Work {
    joined: Vec<f32>,
    grad_joined: Vec<f32>,
    grad_other: Vec<Heard>,
    hidden: Hidden,
}

/// Gradients of what is heard from the neighbours, `[rows, k]`.
#[derive(Debug, Default)]
pub(super) struct Sent(Vec<Heard>);

impl<'a> Message<'a> for Mlp<'a> {
    const SHOWN: usize = MESSAGE;
    type Work = Work;
    type Sent = Sent;

    fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let pair = format!("{name}.message");
        let some = layout.parameters.iter().any(|p| p.name.starts_with(&pair));
        Self {
            pair: some.then(|| Linear::parts(isa, layout, values, &pair, [WIDTH, 3])),
            mix: Perceptron::new(isa, layout, values, &format!("{name}.mix"), Activation::Relu),
        }
    }

    fn show(&self, h: Rows<'_>, shown: &mut [f32]) {
        if let Some([other, _]) = &self.pair {
            other.apply(h, shown, MESSAGE);
        }
    }

    fn add(&self, anchors: Anchors<'_>, y: &mut [f32], _: Option<&mut Maxima>, work: &mut Work) {
        self.join(anchors, &mut work.joined);
        self.mix.add(joined(anchors, &work.joined), y, &mut work.hidden, None);
    }

    fn backward(
        &self,
        anchors: Anchors<'_>,
        _: &Maxima,
        grad: &[f32],
        grad_h: &mut [f32],
        sent: &mut Sent,
        sums: &mut Sums<'_>,
        Work { joined: x, grad_joined, hidden, .. }: &mut Work,
    ) {
        resize(grad_joined, x.len());
        let grad = Rows::new(grad, anchors.count, WIDTH);
        self.mix.backward((joined(anchors, x), None), grad, grad_joined, sums, hidden);
        sent.0.clear();
        sent.0.reserve_exact(anchors.count * anchors.all.inputs.k);
        for (row, grad_h) in joined(anchors, grad_joined).iter().zip(grad_h.chunks_exact_mut(WIDTH)) {
            let (grad_features, heard) = row.split_at(WIDTH);
            grad_h.iter_mut().zip(grad_features).for_each(|(sum, v)| *sum += v);
            sent.0.extend_from_slice(heard.as_chunks().0);
        }
        if let Some([_, position]) = &self.pair {
            let pairs = sent.0.len();
            let relative =
                anchors.all.inputs.relative[anchors.first * anchors.all.inputs.k..][..pairs].as_flattened();
            let grad = Rows::new(sent.0.as_flattened(), pairs, MESSAGE);
            position.weight_gradient(Rows::new(relative, pairs, 3), grad, sums);
        }
    }

    fn shown_backward(
        &self,
        anchors: Anchors<'_>,
        kept: Kept<'_, Sent>,
        grad_h: &mut [f32],
        sums: &mut Sums<'_>,
        Work { grad_other, .. }: &mut Work,
    ) {
        let Some([other, _]) = &self.pair else { return };
        grad_other.clear();
        grad_other.resize(anchors.count, [0.0; MESSAGE]);
        for (j, sum) in (anchors.first..).zip(&mut *grad_other) {
            for (i, place) in kept.lookers.others(j) {
                let heard = &kept.sent_by(i).0[i % BLOCK * kept.lookers.k + place - 1];
                sum.iter_mut().zip(heard).for_each(|(sum, v)| *sum += v);
            }
        }
        let grad_other = Rows::new(grad_other.as_flattened(), anchors.count, MESSAGE);
        other.weight_gradient(anchors.h(), grad_other, sums);
        other.input_gradient(grad_other, grad_h);
    }
}

impl Mlp<'_> {
    /// The inputs of the perceptron: h_i and what is heard from each neighbour.
    fn join(&self, anchors: Anchors<'_>, joined: &mut Vec<f32>) {
        let k = anchors.all.inputs.k;
        let width = WIDTH + k * MESSAGE;
        resize(joined, anchors.count * width);
        let shown: &[Heard] = anchors.all.shown.as_chunks().0;
        for (row, (joined, h)) in joined.chunks_exact_mut(width).zip(anchors.h().iter()).enumerate() {
            let (features, heard) = joined.split_at_mut(WIDTH);
            features.copy_from_slice(h);
            let Some([_, position]) = &self.pair else { continue };
            let pairs = (anchors.first + row) * k..(anchors.first + row + 1) * k;
            let neighbours = &anchors.all.inputs.neighbours[pairs.clone()];
            for (heard, &j) in heard.as_chunks_mut().0.iter_mut().zip(neighbours) {
                *heard = shown[j as usize];
            }
            let relative = anchors.all.inputs.relative[pairs].as_flattened();
            position.product(Rows::new(relative, k, 3), heard, MESSAGE, true);
        }
    }
}

fn joined<'v>(anchors: Anchors<'_>, values: &'v [f32]) -> Rows<'v> {
    Rows::new(values, anchors.count, WIDTH + anchors.all.inputs.k * MESSAGE)
}
