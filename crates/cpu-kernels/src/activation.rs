//! What follows the sums of a layer.

use crate::{dispatch, vector};
use cpu_isa::Isa;
use pulp::{Simd, WithSimd};

/// A function of each value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// None.
    Identity,
    /// max(x, 0).
    Relu,
    /// x Φ(x) with the exact normal distribution.
    Gelu,
    /// x / (1 + e^-x).
    Silu,
    /// tanh x.
    Tanh,
}

impl Activation {
    /// Applies it to every value.
    pub fn apply(self, isa: Isa, values: &mut [f32]) {
        dispatch(isa, Apply { activation: self, values });
    }

    /// Applies it to every value, and multiplies `grad` by its derivative there.
    ///
    /// # Panics
    /// If there are not as many gradients as values.
    pub fn apply_with_gradient(self, isa: Isa, values: &mut [f32], grad: &mut [f32]) {
        assert_eq!(values.len(), grad.len(), "a gradient for every value");
        dispatch(isa, Gradient { activation: self, values, grad });
    }

    #[inline(always)]
    fn value_and_slope<S: Simd>(self, simd: S, x: S::f32s) -> (S::f32s, S::f32s) {
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        match self {
            Self::Identity => (x, one),
            Self::Relu => {
                let slope = vector::select(simd, simd.greater_than_f32s(x, zero), one, zero);
                (vector::relu(simd, x), slope)
            }
            Self::Gelu => vector::gelu_and_slope(simd, x),
            Self::Silu => {
                let logistic =
                    simd.div_f32s(one, simd.add_f32s(one, vector::exp(simd, vector::neg(simd, x))));
                let rest = simd.sub_f32s(one, logistic);
                let slope = simd.mul_f32s(logistic, simd.mul_add_e_f32s(x, rest, one));
                (simd.mul_f32s(x, logistic), slope)
            }
            Self::Tanh => {
                let value = vector::tanh(simd, x);
                (value, simd.negate_mul_add_e_f32s(value, value, one))
            }
        }
    }
}

struct Apply<'a> {
    activation: Activation,
    values: &'a mut [f32],
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.activation {
            Activation::Identity => {}
            Activation::Relu => vector::map(
                simd,
                self.values,
                #[inline(always)]
                |x| vector::relu(simd, x),
            ),
            Activation::Gelu => vector::map(
                simd,
                self.values,
                #[inline(always)]
                |x| vector::gelu(simd, x),
            ),
            Activation::Silu => vector::map(
                simd,
                self.values,
                #[inline(always)]
                |x| vector::silu(simd, x),
            ),
            Activation::Tanh => vector::map(
                simd,
                self.values,
                #[inline(always)]
                |x| vector::tanh(simd, x),
            ),
        }
    }
}

struct Gradient<'a> {
    activation: Activation,
    values: &'a mut [f32],
    grad: &'a mut [f32],
}

impl WithSimd for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { activation, values, grad } = self;
        let ((vectors, rest), (grads, grad_rest)) = (S::as_mut_simd_f32s(values), S::as_mut_simd_f32s(grad));
        for (v, grad) in vectors.iter_mut().zip(grads) {
            let (value, slope) = activation.value_and_slope(simd, *v);
            *v = value;
            *grad = simd.mul_f32s(*grad, slope);
        }
        if !rest.is_empty() {
            let (value, slope) = activation.value_and_slope(simd, simd.partial_load_f32s(rest));
            simd.partial_store_f32s(rest, value);
            let grad = simd.partial_load_f32s(grad_rest);
            simd.partial_store_f32s(grad_rest, simd.mul_f32s(grad, slope));
        }
    }
}
