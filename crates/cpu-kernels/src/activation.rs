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
        dispatch(isa, Apply { activation: self, x: None, out: values });
    }

    /// What it makes of every value of `x`.
    ///
    /// # Panics
    /// If `out` is of another length.
    pub fn write(self, isa: Isa, x: &[f32], out: &mut [f32]) {
        assert_eq!(x.len(), out.len(), "as many outputs as inputs");
        dispatch(isa, Apply { activation: self, x: Some(x), out });
    }

    /// As [`Self::write`]; multiplies `grad` by the derivative at each value, too.
    ///
    /// # Panics
    /// If the lengths do not agree.
    pub fn write_with_gradient(self, isa: Isa, x: &[f32], out: &mut [f32], grad: &mut [f32]) {
        assert!(x.len() == out.len() && x.len() == grad.len(), "an output and a gradient for every value");
        dispatch(isa, Gradient { activation: self, x, out, grad });
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
    /// None if it is applied in place.
    x: Option<&'a [f32]>,
    out: &'a mut [f32],
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.activation {
            Activation::Identity => self.each(
                simd,
                #[inline(always)]
                |x| x,
            ),
            Activation::Relu => self.each(
                simd,
                #[inline(always)]
                |x| vector::relu(simd, x),
            ),
            Activation::Gelu => self.each(
                simd,
                #[inline(always)]
                |x| vector::gelu(simd, x),
            ),
            Activation::Silu => self.each(
                simd,
                #[inline(always)]
                |x| vector::silu(simd, x),
            ),
            Activation::Tanh => self.each(
                simd,
                #[inline(always)]
                |x| vector::tanh(simd, x),
            ),
        }
    }
}

impl Apply<'_> {
    #[inline(always)]
    fn each<S: Simd>(self, simd: S, f: impl Fn(S::f32s) -> S::f32s) {
        match self.x {
            None => vector::map(simd, self.out, f),
            Some(x) => vector::map2(
                simd,
                self.out,
                x,
                #[inline(always)]
                |_, x| f(x),
            ),
        }
    }
}

struct Gradient<'a> {
    activation: Activation,
    x: &'a [f32],
    out: &'a mut [f32],
    grad: &'a mut [f32],
}

impl WithSimd for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { activation, x, out, grad } = self;
        let (x, x_rest) = S::as_simd_f32s(x);
        let ((out, out_rest), (grad, grad_rest)) = (S::as_mut_simd_f32s(out), S::as_mut_simd_f32s(grad));
        for ((x, out), grad) in x.iter().zip(out).zip(grad) {
            let (value, slope) = activation.value_and_slope(simd, *x);
            *out = value;
            *grad = simd.mul_f32s(*grad, slope);
        }
        if !x_rest.is_empty() {
            let (value, slope) = activation.value_and_slope(simd, simd.partial_load_f32s(x_rest));
            simd.partial_store_f32s(out_rest, value);
            let grad = simd.partial_load_f32s(grad_rest);
            simd.partial_store_f32s(grad_rest, simd.mul_f32s(grad, slope));
        }
    }
}
