//! Layer normalisation of rows, forward and backward.

use crate::{dispatch, vector};
use cpu_isa::Isa;
use pulp::{Simd, WithSimd};

/// Scale and shift of a layer normalisation, and what keeps a constant row finite.
#[derive(Debug, Clone, Copy)]
pub struct LayerNorm<'a> {
    /// Scale of each column.
    pub weight: &'a [f32],
    /// Shift of each column.
    pub bias: &'a [f32],
    /// Added to the variance.
    pub epsilon: f32,
}

impl LayerNorm<'_> {
    /// out = (x - mean) / sqrt(variance + epsilon) · weight + bias along each row of `weight.len()` columns.
    ///
    /// # Panics
    /// If there are no whole rows, or `out` is of another size.
    pub fn apply(&self, isa: Isa, x: &[f32], out: &mut [f32]) {
        self.check(x);
        assert_eq!(x.len(), out.len(), "as many outputs as inputs");
        dispatch(isa, Forward { norm: self, x, out });
    }

    /// From the gradient of the output adds to that of the input, and to those of scale and shift.
    ///
    /// # Panics
    /// If the sizes do not agree.
    pub fn backward(
        &self,
        isa: Isa,
        x: &[f32],
        grad_out: &[f32],
        grad_x: &mut [f32],
        (grad_weight, grad_bias): (&mut [f32], &mut [f32]),
    ) {
        self.check(x);
        assert!(x.len() == grad_out.len() && x.len() == grad_x.len(), "gradients of all values");
        let columns = self.weight.len();
        assert!(grad_weight.len() == columns && grad_bias.len() == columns, "gradients of scale and shift");
        dispatch(isa, Backward { norm: self, x, grad_out, grad_x, grad_weight, grad_bias });
    }

    fn check(&self, x: &[f32]) {
        assert_eq!(self.weight.len(), self.bias.len(), "scale and shift of every column");
        assert_eq!(x.len() % self.weight.len().max(1), 0, "whole rows");
    }

    /// out = (x - mean) / sqrt(variance + epsilon) of a row; returns the factor.
    #[inline(always)]
    fn normalise<S: Simd>(&self, simd: S, x: &[f32], out: &mut [f32]) -> f32 {
        let count = x.len() as f32;
        // The mean in two parts, which together have more digits than f32: an offset does not blur small differences.
        let near = simd.splat_f32s(vector::sum(simd, x, |v| v) / count);
        let rest = simd.splat_f32s(vector::sum(simd, x, |v| simd.sub_f32s(v, near)) / count);
        let apart = |v| simd.sub_f32s(simd.sub_f32s(v, near), rest);
        let square = |v| {
            let apart = apart(v);
            simd.mul_f32s(apart, apart)
        };
        let variance = vector::sum(simd, x, square) / count;
        if !variance.is_finite() {
            return self.normalise_wide(x, out);
        }
        let scale = 1.0 / (variance + self.epsilon).sqrt();
        let factor = simd.splat_f32s(scale);
        vector::map2(simd, out, x, |_, v| simd.mul_f32s(apart(v), factor));
        scale
    }

    /// In f64: a row may be as large as f32 can hold, and its squares cannot.
    #[cold]
    fn normalise_wide(&self, x: &[f32], out: &mut [f32]) -> f32 {
        let count = x.len() as f64;
        let mean = x.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
        let variance = x.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
        let scale = 1.0 / (variance + f64::from(self.epsilon)).sqrt();
        for (out, &v) in out.iter_mut().zip(x) {
            *out = ((f64::from(v) - mean) * scale) as f32;
        }
        scale as f32
    }
}

struct Forward<'a> {
    norm: &'a LayerNorm<'a>,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { norm, x, out } = self;
        let columns = norm.weight.len().max(1);
        for (x, out) in x.chunks_exact(columns).zip(out.chunks_exact_mut(columns)) {
            norm.normalise(simd, x, out);
            vector::map3(simd, out, (norm.weight, norm.bias), |v, weight, bias| {
                simd.mul_add_e_f32s(v, weight, bias)
            });
        }
    }
}

struct Backward<'a> {
    norm: &'a LayerNorm<'a>,
    x: &'a [f32],
    grad_out: &'a [f32],
    grad_x: &'a mut [f32],
    grad_weight: &'a mut [f32],
    grad_bias: &'a mut [f32],
}

impl WithSimd for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { norm, x, grad_out, grad_x, grad_weight, grad_bias } = self;
        let columns = norm.weight.len().max(1);
        let count = columns as f32;
        let (mut normal, mut grad) = (vec![0.0; columns], vec![0.0; columns]);
        let rows = x.chunks_exact(columns).zip(grad_out.chunks_exact(columns));
        for ((x, grad_out), grad_x) in rows.zip(grad_x.chunks_exact_mut(columns)) {
            let scale = simd.splat_f32s(norm.normalise(simd, x, &mut normal));
            grad.copy_from_slice(grad_out);
            vector::map2(simd, &mut grad, norm.weight, |g, weight| simd.mul_f32s(g, weight));
            let product = |sum, g, v| simd.mul_add_e_f32s(g, v, sum);
            vector::map3(simd, grad_weight, (grad_out, &normal), product);
            vector::map2(simd, grad_bias, grad_out, |sum, g| simd.add_f32s(sum, g));
            let along_one = simd.splat_f32s(vector::sum(simd, &grad, |g| g) / count);
            let along_normal = simd.splat_f32s(-vector::dot(simd, &grad, &normal) / count);
            let gradient = |sum, g, v| {
                let across = simd.mul_add_e_f32s(v, along_normal, simd.sub_f32s(g, along_one));
                simd.mul_add_e_f32s(across, scale, sum)
            };
            vector::map3(simd, grad_x, (&grad, &normal), gradient);
        }
    }
}
