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

    /// Mean and factor of each of some rows, whose normal form is (x - mean) · factor. The mean is in two parts, which together have more digits than
    /// f32: an offset does not blur small differences; the first is that of [`SOME`] values. None if f32 cannot hold the variance.
    ///
    /// What ends a sum waits long for its results: the sums of other rows go on meanwhile.
    #[inline(always)]
    fn moments<S: Simd, const ROWS: usize>(&self, simd: S, rows: [&[f32]; ROWS]) -> [Option<Moments>; ROWS] {
        let count = self.weight.len() as f32;
        let mut near = [0.0; ROWS];
        for (near, row) in near.iter_mut().zip(rows) {
            let some = &row[..row.len().min(SOME)];
            *near = vector::sum(
                simd,
                some,
                #[inline(always)]
                |v| v,
            ) / some.len() as f32;
        }
        let mut sums = [(0.0, 0.0); ROWS];
        for ((sums, row), near) in sums.iter_mut().zip(rows).zip(near) {
            let middle = simd.splat_f32s(near);
            *sums = vector::sum_and_squares(
                simd,
                row,
                #[inline(always)]
                |v| simd.sub_f32s(v, middle),
            );
        }
        let mut moments = [None; ROWS];
        for ((moments, (sum, squares)), near) in moments.iter_mut().zip(sums).zip(near) {
            let rest = sum / count;
            // Differences from the first part: its error is all that their mean has.
            let variance = squares / count - rest * rest;
            let factor = 1.0 / (variance.max(0.0) + self.epsilon).sqrt();
            *moments = variance.is_finite().then_some(Moments { near, rest, factor });
        }
        moments
    }

    /// out = (x - mean) / sqrt(variance + epsilon) · weight + bias of a row with these moments.
    #[inline(always)]
    fn write<S: Simd>(&self, simd: S, x: &[f32], moments: Option<Moments>, out: &mut [f32]) {
        let Some(Moments { near, rest, factor }) = moments else {
            self.normalise_wide(x, out);
            vector::map3(
                simd,
                out,
                (self.weight, self.bias),
                #[inline(always)]
                |v, weight, bias| simd.mul_add_e_f32s(v, weight, bias),
            );
            return;
        };
        let (near, rest) = (simd.splat_f32s(near), simd.splat_f32s(rest));
        let factor = simd.splat_f32s(factor);
        vector::write3(
            simd,
            out,
            (x, self.weight, self.bias),
            #[inline(always)]
            |v, weight, bias| {
                let apart = simd.sub_f32s(simd.sub_f32s(v, near), rest);
                simd.mul_add_e_f32s(simd.mul_f32s(apart, factor), weight, bias)
            },
        );
    }

    /// out = (x - mean) / sqrt(variance + epsilon) of a row; returns the factor.
    #[inline(always)]
    fn normalise<S: Simd>(&self, simd: S, x: &[f32], out: &mut [f32]) -> f32 {
        let [Some(Moments { near, rest, factor })] = self.moments(simd, [x]) else {
            return self.normalise_wide(x, out);
        };
        let (near, rest, by) = (simd.splat_f32s(near), simd.splat_f32s(rest), simd.splat_f32s(factor));
        vector::map2(
            simd,
            out,
            x,
            #[inline(always)]
            |_, v| simd.mul_f32s(simd.sub_f32s(simd.sub_f32s(v, near), rest), by),
        );
        factor
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

/// As many values have a mean that is near enough to that of a row: squares of differences from it lose few digits.
const SOME: usize = 16;

/// What a row is normalised by.
#[derive(Clone, Copy)]
struct Moments {
    /// The mean, in two parts.
    near: f32,
    rest: f32,
    factor: f32,
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
        const TOGETHER: usize = 4;
        let Self { norm, x, out } = self;
        let columns = norm.weight.len().max(1);
        let (mut groups, mut outs) =
            (x.chunks_exact(TOGETHER * columns), out.chunks_exact_mut(TOGETHER * columns));
        for (group, out) in groups.by_ref().zip(outs.by_ref()) {
            let rows: [&[f32]; TOGETHER] = std::array::from_fn(|i| &group[i * columns..][..columns]);
            let moments = norm.moments(simd, rows);
            for ((row, moments), out) in rows.into_iter().zip(moments).zip(out.chunks_exact_mut(columns)) {
                norm.write(simd, row, moments, out);
            }
        }
        let rest =
            groups.remainder().chunks_exact(columns).zip(outs.into_remainder().chunks_exact_mut(columns));
        for (row, out) in rest {
            let [moments] = norm.moments(simd, [row]);
            norm.write(simd, row, moments, out);
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
            vector::map2(
                simd,
                &mut grad,
                norm.weight,
                #[inline(always)]
                |g, weight| simd.mul_f32s(g, weight),
            );
            vector::map3(
                simd,
                grad_weight,
                (grad_out, &normal),
                #[inline(always)]
                |sum, g, v| simd.mul_add_e_f32s(g, v, sum),
            );
            vector::map2(
                simd,
                grad_bias,
                grad_out,
                #[inline(always)]
                |sum, g| simd.add_f32s(sum, g),
            );
            let along_one = simd.splat_f32s(
                vector::sum(
                    simd,
                    &grad,
                    #[inline(always)]
                    |g| g,
                ) / count,
            );
            let along_normal = simd.splat_f32s(-vector::dot(simd, &grad, &normal) / count);
            vector::map3(
                simd,
                grad_x,
                (&grad, &normal),
                #[inline(always)]
                |sum, g, v| {
                    let across = simd.mul_add_e_f32s(v, along_normal, simd.sub_f32s(g, along_one));
                    simd.mul_add_e_f32s(across, scale, sum)
                },
            );
        }
    }
}
