//! Linear layers on rows.

use super::sums::{Place, Sums};
use crate::Layout;
use cpu_kernels::{Isa, Packed, Rows, multiply, multiply_transposed, multiply_with_bias, rows};
use std::ops::Range;
use std::sync::OnceLock;

/// y = W x + b, or the part of a layer for some of its inputs.
#[derive(Debug)]
pub(super) struct Linear<'a> {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    weight: Rows<'a>,
    /// None of a part without the first input.
    bias: Option<&'a [f32]>,
    /// The whole weight, whose rows are `stride` long, and where the part begins in a row.
    weight_at: Place,
    stride: usize,
    first: usize,
    bias_at: Place,
    /// Wᵀ, which rows are multiplied with.
    forward: Packed,
    /// W, for the gradient; packed when first asked for.
    backward: OnceLock<Packed>,
}

impl<'a> Linear<'a> {
    pub(super) fn new(isa: Isa, layout: &Layout, values: &'a [f32], name: &str) -> Self {
        let (weight, bias) = Place::pair(layout, name);
        let inputs = weight.of(values).len() / bias.of(values).len();
        Self::part(isa, layout, values, name, 0..inputs)
    }

    /// One layer for each group of inputs, one group behind the other. Their outputs add up to those of the whole.
    pub(super) fn parts<const N: usize>(
        isa: Isa,
        layout: &Layout,
        values: &'a [f32],
        name: &str,
        widths: [usize; N],
    ) -> [Self; N] {
        let mut end = 0;
        widths.map(|width| {
            let first = end;
            end += width;
            Self::part(isa, layout, values, name, first..end)
        })
    }

    fn part(isa: Isa, layout: &Layout, values: &'a [f32], name: &str, columns: Range<usize>) -> Self {
        let (weight_at, bias_at) = Place::pair(layout, name);
        let (weight, bias) = (weight_at.of(values), bias_at.of(values));
        let (outputs, stride) = (bias.len(), weight.len() / bias.len());
        let weight = Rows::new(weight, outputs, stride).columns(columns.start, columns.len());
        Self {
            inputs: columns.len(),
            outputs,
            weight,
            bias: (columns.start == 0).then_some(bias),
            weight_at,
            stride,
            first: columns.start,
            bias_at,
            forward: Packed::transposed(isa, weight),
            backward: OnceLock::new(),
        }
    }

    /// W, a row for each output.
    pub(super) fn weight(&self) -> Rows<'a> {
        self.weight
    }

    /// W x of rows to the first columns of rows `stride` apart, or added to them; without the bias.
    pub(super) fn product(&self, x: Rows<'_>, out: &mut [f32], stride: usize, add: bool) {
        multiply(x, &self.forward, out, stride, add);
    }

    /// Rows of `inputs` to the first columns of rows `stride` apart.
    pub(super) fn apply(&self, x: Rows<'_>, out: &mut [f32], stride: usize) {
        match self.bias {
            Some(bias) => multiply_with_bias(x, &self.forward, bias, out, stride, false),
            None => self.product(x, out, stride, false),
        }
    }

    /// Adds the layer's output to rows of `outputs`.
    pub(super) fn add(&self, x: Rows<'_>, out: &mut [f32]) {
        match self.bias {
            Some(bias) => multiply_with_bias(x, &self.forward, bias, out, self.outputs, true),
            None => self.product(x, out, self.outputs, true),
        }
    }

    /// Adds the bias to rows of `outputs`.
    pub(super) fn add_bias(&self, out: &mut [f32]) {
        if let Some(bias) = self.bias {
            rows::add_to_each(self.forward.isa(), out, bias);
        }
    }

    /// Adds Wᵀ times the gradient of the output to the input's.
    pub(super) fn input_gradient(&self, grad_out: Rows<'_>, grad_x: &mut [f32]) {
        multiply(grad_out, self.backward(), grad_x, self.inputs, true);
    }

    /// The same where the input has no other gradient: replaces what `grad_x` holds.
    pub(super) fn input_gradient_alone(&self, grad_out: Rows<'_>, grad_x: &mut [f32]) {
        multiply(grad_out, self.backward(), grad_x, self.inputs, false);
    }

    fn backward(&self) -> &Packed {
        self.backward.get_or_init(|| Packed::rows(self.forward.isa(), self.weight))
    }

    /// Adds to the parameters' gradients.
    pub(super) fn weight_gradient(&self, x: Rows<'_>, grad_out: Rows<'_>, sums: &mut Sums<'_>) {
        let (sum, stride) = self.weight_sum(sums);
        multiply_transposed(self.forward.isa(), grad_out, x, sum, stride);
        self.bias_gradient(grad_out, sums);
    }

    /// Adds to the bias's gradient.
    pub(super) fn bias_gradient(&self, grad_out: Rows<'_>, sums: &mut Sums<'_>) {
        if self.bias.is_some() {
            rows::add_sum(self.forward.isa(), grad_out, sums.at(self.bias_at));
        }
    }

    /// The gradient of W: rows of `inputs`, and how far apart they begin.
    pub(super) fn weight_sum<'s>(&self, sums: &'s mut Sums<'_>) -> (&'s mut [f32], usize) {
        (&mut sums.at(self.weight_at)[self.first..], self.stride)
    }
}
