//! Sums, products and mixtures of rows.

use crate::{Rows, dispatch, vector};
use cpu_isa::Isa;
use pulp::{Simd, WithSimd};

/// What is done to values and others beside them.
#[derive(Clone, Copy)]
enum Pointwise {
    Add,
    Multiply,
    AddAndClip,
}

impl Pointwise {
    #[inline(always)]
    fn apply<S: Simd>(self, simd: S, values: &mut [f32], other: &[f32]) {
        match self {
            Self::Add => vector::map2(
                simd,
                values,
                other,
                #[inline(always)]
                |v, o| simd.add_f32s(v, o),
            ),
            Self::Multiply => vector::map2(
                simd,
                values,
                other,
                #[inline(always)]
                |v, o| simd.mul_f32s(v, o),
            ),
            Self::AddAndClip => vector::map2(
                simd,
                values,
                other,
                #[inline(always)]
                |v, o| vector::relu(simd, simd.add_f32s(v, o)),
            ),
        }
    }
}

struct WithRow<'a>(Pointwise, &'a mut [f32], &'a [f32]);

impl WithSimd for WithRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self(operation, values, row) = self;
        for values in values.chunks_exact_mut(row.len().max(1)) {
            operation.apply(simd, values, row);
        }
    }
}

/// values += others.
///
/// # Panics
/// If the lengths do not agree.
pub fn add(isa: Isa, values: &mut [f32], others: &[f32]) {
    assert_eq!(values.len(), others.len(), "values side by side");
    dispatch(isa, WithRow(Pointwise::Add, values, others));
}

/// values = max(values + others, 0).
///
/// # Panics
/// If the lengths do not agree.
pub fn add_and_clip(isa: Isa, values: &mut [f32], others: &[f32]) {
    assert_eq!(values.len(), others.len(), "values side by side");
    dispatch(isa, WithRow(Pointwise::AddAndClip, values, others));
}

/// Adds a row to every row of `values`, which lie without gaps.
///
/// # Panics
/// If the lengths do not agree.
pub fn add_to_each(isa: Isa, values: &mut [f32], row: &[f32]) {
    assert_eq!(values.len() % row.len().max(1), 0, "whole rows");
    dispatch(isa, WithRow(Pointwise::Add, values, row));
}

/// Multiplies every row of `values` by a row, value by value.
///
/// # Panics
/// If the lengths do not agree.
pub fn multiply_each(isa: Isa, values: &mut [f32], row: &[f32]) {
    assert_eq!(values.len() % row.len().max(1), 0, "whole rows");
    dispatch(isa, WithRow(Pointwise::Multiply, values, row));
}

/// Adds the sum of all rows to `sums`.
///
/// # Panics
/// If the lengths do not agree.
pub fn add_sum(isa: Isa, rows: Rows<'_>, sums: &mut [f32]) {
    assert_eq!(rows.width(), sums.len(), "a sum for every column");
    dispatch(isa, Sum { rows, sums });
}

struct Sum<'a> {
    rows: Rows<'a>,
    sums: &'a mut [f32],
}

impl WithSimd for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.rows.iter() {
            Pointwise::Add.apply(simd, self.sums, row);
        }
    }
}

/// Adds the sum of (row - mean)² over all rows to `sums`, column by column.
///
/// # Panics
/// If the lengths do not agree.
pub fn add_squares(isa: Isa, rows: Rows<'_>, mean: &[f32], sums: &mut [f32]) {
    assert!(rows.width() == sums.len() && mean.len() == sums.len(), "a mean and a sum for every column");
    dispatch(isa, Squares { rows, mean, sums });
}

struct Squares<'a> {
    rows: Rows<'a>,
    mean: &'a [f32],
    sums: &'a mut [f32],
}

impl WithSimd for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.rows.iter() {
            vector::map3(
                simd,
                self.sums,
                (row, self.mean),
                #[inline(always)]
                |sum, v, mean| {
                    let apart = simd.sub_f32s(v, mean);
                    simd.mul_add_e_f32s(apart, apart, sum)
                },
            );
        }
    }
}

/// For every row, out = (x - mean) · factor, column by column.
///
/// # Panics
/// If the lengths do not agree.
pub fn scale_apart(isa: Isa, x: &[f32], mean: &[f32], factor: &[f32], out: &mut [f32]) {
    assert!(x.len() == out.len() && mean.len() == factor.len(), "as many outputs as inputs");
    assert_eq!(x.len() % mean.len().max(1), 0, "whole rows");
    out.copy_from_slice(x);
    dispatch(isa, ScaleApart { mean, factor, out });
}

struct ScaleApart<'a> {
    mean: &'a [f32],
    factor: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for ScaleApart<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for row in self.out.chunks_exact_mut(self.mean.len().max(1)) {
            vector::map3(
                simd,
                row,
                (self.mean, self.factor),
                #[inline(always)]
                |v, mean, factor| simd.mul_f32s(simd.sub_f32s(v, mean), factor),
            );
        }
    }
}

/// out = (1 - weight) a + weight b.
///
/// # Panics
/// If the lengths do not agree.
pub fn mix(isa: Isa, a: &[f32], b: &[f32], weight: f32, out: &mut [f32]) {
    assert!(a.len() == out.len() && b.len() == out.len(), "rows side by side");
    dispatch(isa, Mix { a, b, weight, out });
}

struct Mix<'a> {
    a: &'a [f32],
    b: &'a [f32],
    weight: f32,
    out: &'a mut [f32],
}

impl WithSimd for Mix<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (first, second) = (simd.splat_f32s(1.0 - self.weight), simd.splat_f32s(self.weight));
        vector::map3(
            simd,
            self.out,
            (self.a, self.b),
            #[inline(always)]
            |_, a, b| simd.mul_add_e_f32s(b, second, simd.mul_f32s(a, first)),
        );
    }
}

/// The product of two rows.
///
/// # Panics
/// If the lengths do not agree.
#[must_use]
pub fn dot(isa: Isa, a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len(), "rows of one length");
    dispatch(isa, Dot(a, b))
}

struct Dot<'a>(&'a [f32], &'a [f32]);

impl WithSimd for Dot<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        vector::dot(simd, self.0, self.1)
    }
}

/// Replaces scores by exp(score - largest), where a score is the value times `scale`, less 100 where a key's label is not
/// the row's; returns their sum.
///
/// # Panics
/// If the lengths do not agree.
pub fn exponentials(isa: Isa, row: &mut [f32], scale: f32, labels: Option<(f32, &[f32])>) -> f32 {
    assert!(labels.is_none_or(|(_, keys)| keys.len() == row.len()), "a label for every key");
    dispatch(isa, Exponentials { row, scale, labels })
}

struct Exponentials<'a> {
    row: &'a mut [f32],
    scale: f32,
    labels: Option<(f32, &'a [f32])>,
}

impl WithSimd for Exponentials<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let Self { row, scale, labels } = self;
        let scale = simd.splat_f32s(scale);
        match labels {
            None => vector::map(
                simd,
                row,
                #[inline(always)]
                |v| simd.mul_f32s(v, scale),
            ),
            Some((label, keys)) => {
                let (label, zero, apart) =
                    (simd.splat_f32s(label), simd.splat_f32s(0.0), simd.splat_f32s(-100.0));
                vector::map2(
                    simd,
                    row,
                    keys,
                    #[inline(always)]
                    |v, key| {
                        let mask = vector::select(simd, simd.equal_f32s(key, label), zero, apart);
                        simd.mul_add_e_f32s(v, scale, mask)
                    },
                );
            }
        }
        let most = simd.splat_f32s(vector::largest(simd, row));
        vector::map(
            simd,
            row,
            #[inline(always)]
            |v| vector::exp(simd, simd.sub_f32s(v, most)),
        );
        vector::sum(
            simd,
            row,
            #[inline(always)]
            |v| v,
        )
    }
}
