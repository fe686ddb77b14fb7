//! Two linear layers with an activation between them.

use super::linear::Linear;
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

    /// Rows to the first columns of rows `stride` apart.
    pub(super) fn apply(&self, x: Rows<'_>, out: &mut [f32], stride: usize, hidden: &mut Hidden) {
        self.activate(x, hidden);
        self.second.apply(self.rows(&hidden.values, x), out, stride);
    }

    /// Adds the output to rows of its width.
    pub(super) fn add(&self, x: Rows<'_>, out: &mut [f32], hidden: &mut Hidden) {
        self.activate(x, hidden);
        self.second.add(self.rows(&hidden.values, x), out);
    }

    /// Adds to the gradients of `x` and of the parameters what follows from the gradient of the output.
    pub(super) fn backward(
        &self,
        x: Rows<'_>,
        grad_out: Rows<'_>,
        grad_x: &mut [f32],
        sums: &mut Sums<'_>,
        Hidden { values, grad }: &mut Hidden,
    ) {
        values.resize(x.count() * self.first.outputs, 0.0);
        self.first.apply(x, values, self.first.outputs);
        grad.clear();
        grad.resize(values.len(), 0.0);
        self.second.input_gradient(grad_out, grad);
        self.activation.apply_with_gradient(self.isa, values, grad);
        self.second.weight_gradient(self.rows(values, x), grad_out, sums);
        let grad = self.rows(grad, x);
        self.first.weight_gradient(x, grad, sums);
        self.first.input_gradient(grad, grad_x);
    }

    fn activate(&self, x: Rows<'_>, hidden: &mut Hidden) {
        hidden.values.resize(x.count() * self.first.outputs, 0.0);
        self.first.apply(x, &mut hidden.values, self.first.outputs);
        self.activation.apply(self.isa, &mut hidden.values);
    }

    fn rows<'v>(&self, values: &'v [f32], x: Rows<'_>) -> Rows<'v> {
        Rows::new(values, x.count(), self.first.outputs)
    }
}
