//! Two linear layers with an activation between them.

use super::linear::Linear;
use super::message::resize;
use super::sums::Sums;
use crate::Layout;
use cpu_kernels::{Activation, Isa, Rows};

/// y = W₂ a(W₁ x + b₁) + b₂.
#[derive(Debug)]
pub(super) struct Perceptron<'a> {
    isa: Isa,
    first: Linear<'a>,
    second: Linear<'a>,
    activation: Activation,
}

/// Memory of a block.
#[derive(Debug, Default)]
pub(super) struct Hidden {
    /// What is activated.
    before: Vec<f32>,
    values: Vec<f32>,
    grad: Vec<f32>,
}

impl<'a> Perceptron<'a> {
    pub(super) fn new(
        isa: Isa,
        layout: &Layout,
        values: &'a [f32],
        name: &str,
        activation: Activation,
    ) -> Self {
        let first = Linear::new(isa, layout, values, &format!("{name}.0"));
        let second = Linear::new(isa, layout, values, &format!("{name}.2"));
        Self { isa, first, second, activation }
    }

    /// Rows to the first columns of rows `stride` apart. `kept`, if there is one, is filled with what is activated.
    pub(super) fn apply(
        &self,
        x: Rows<'_>,
        out: &mut [f32],
        stride: usize,
        hidden: &mut Hidden,
        kept: Option<&mut Vec<f32>>,
    ) {
        self.activate(x, hidden, kept);
        self.second.apply(self.rows(&hidden.values, x), out, stride);
    }

    /// Adds the output to rows of its width. `kept` as in [`apply`](Self::apply).
    pub(super) fn add(&self, x: Rows<'_>, out: &mut [f32], hidden: &mut Hidden, kept: Option<&mut Vec<f32>>) {
        self.activate(x, hidden, kept);
        self.second.add(self.rows(&hidden.values, x), out);
    }

    /// From the gradient of the output computes that of `x`, and adds to those of the parameters. What was not `kept` is computed again.
    pub(super) fn backward(
        &self,
        (x, kept): (Rows<'_>, Option<&[f32]>),
        grad_out: Rows<'_>,
        grad_x: &mut [f32],
        sums: &mut Sums<'_>,
        Hidden { before, values, grad }: &mut Hidden,
    ) {
        let before = match kept {
            Some(kept) => kept,
            None => {
                self.first_layer(x, before);
                before
            }
        };
        resize(values, before.len());
        resize(grad, before.len());
        self.second.input_gradient_alone(grad_out, grad);
        self.activation.write_with_gradient(self.isa, before, values, grad);
        self.second.weight_gradient(self.rows(values, x), grad_out, sums);
        let grad = self.rows(grad, x);
        self.first.weight_gradient(x, grad, sums);
        self.first.input_gradient_alone(grad, grad_x);
    }

    fn activate(&self, x: Rows<'_>, Hidden { values, .. }: &mut Hidden, kept: Option<&mut Vec<f32>>) {
        if let Some(kept) = kept {
            self.first_layer(x, kept);
            resize(values, kept.len());
            self.activation.write(self.isa, kept, values);
        } else {
            self.first_layer(x, values);
            self.activation.apply(self.isa, values);
        }
    }

    fn first_layer(&self, x: Rows<'_>, values: &mut Vec<f32>) {
        resize(values, x.count() * self.first.outputs);
        self.first.apply(x, values, self.first.outputs);
    }

    fn rows<'v>(&self, values: &'v [f32], x: Rows<'_>) -> Rows<'v> {
        Rows::new(values, x.count(), self.first.outputs)
    }
}
