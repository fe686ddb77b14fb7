//! The loops over pairs.

use super::{Maxima, Sent};
use crate::fused::message::{Kept, Row, each};
use crate::fused::network::BLOCK;
use crate::{Inputs, WIDTH};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::vector::{relu, select};

/// Who sees whom, and what h_ij is made from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pairs<'a> {
    pub(super) inputs: &'a Inputs<'a>,
    /// `[n, 128]` other, or `[n, 256]` other and own.
    pub(super) shown: &'a [f32],
    /// Numbers that each shows.
    pub(super) width: usize,
    /// P by columns.
    pub(super) position: &'a [Row; 3],
}

/// The `own` of anchors that have none.
const NONE: &Row = &[0.0; WIDTH];

impl Pairs<'_> {
    /// Pairs of each anchor.
    fn each(&self) -> usize {
        self.inputs.k + 1
    }

    /// Whom anchor i sees at a place, the first being itself, and where.
    #[inline(always)]
    fn seen(&self, i: usize, place: usize) -> (usize, [f32; 3]) {
        match place.checked_sub(1) {
            None => (i, [0.0; 3]),
            Some(place) => {
                let pair = i * self.inputs.k + place;
                (self.inputs.neighbours[pair] as usize, self.inputs.relative[pair])
            }
        }
    }

    #[inline(always)]
    fn shown(&self, i: usize) -> &[Row] {
        each(&self.shown[i * self.width..][..self.width])
    }

    /// h_ij.
    #[inline(always)]
    fn hidden<S: Simd>(&self, simd: S, i: usize, (j, relative): (usize, [f32; 3]), out: &mut Row) {
        let anchor = vectors::<S>(self.shown(i).get(1).unwrap_or(NONE));
        let other = vectors::<S>(&self.shown(j)[0]);
        let [px, py, pz] = self.position.each_ref().map(|column| vectors::<S>(column));
        let [x, y, z] = relative.map(|v| simd.splat_f32s(v));
        for (vector, out) in vectors_mut::<S>(out).iter_mut().enumerate() {
            let sum = simd.add_f32s(anchor[vector], other[vector]);
            let sum = simd.mul_add_e_f32s(px[vector], x, sum);
            let sum = simd.mul_add_e_f32s(py[vector], y, sum);
            let sum = simd.mul_add_e_f32s(pz[vector], z, sum);
            *out = relu(simd, sum);
        }
    }
}

/// h_ij of all pairs of some anchors.
pub(super) struct Hidden<'a> {
    pub(super) pairs: Pairs<'a>,
    pub(super) first: usize,
    pub(super) out: &'a mut [Row],
}

impl WithSimd for Hidden<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pairs, first, out } = self;
        for (row, out) in out.chunks_exact_mut(pairs.each()).enumerate() {
            let i = first + row;
            for (place, out) in out.iter_mut().enumerate() {
                pairs.hidden(simd, i, pairs.seen(i, place), out);
            }
        }
    }
}

/// Vectors in registers at a time.
const CHUNK: usize = 8;
/// Half as many where each has another beside it, of value and of place: all stay in registers, and none is selected in memory ([`select`]).
const PAIRED: usize = CHUNK / 2;

/// The largest value of each channel over the pairs of an anchor, and the first pair that has it; of NaNs the last.
pub(super) struct Largest<'a> {
    pub(super) products: &'a [Row],
    pub(super) values: &'a mut Row,
    pub(super) picks: &'a mut [u32; WIDTH],
}

impl WithSimd for Largest<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { products, values, picks } = self;
        let (first, others) = products.split_first().expect("an anchor sees itself");
        let values = vectors_mut::<S>(values).as_chunks_mut::<PAIRED>().0;
        let picks = S::as_mut_simd_u32s(picks).0.as_chunks_mut().0;
        for (part, (values, picks)) in values.iter_mut().zip(picks).enumerate() {
            let mut largest = vectors::<S>(first).as_chunks::<PAIRED>().0[part];
            let mut places = [simd.splat_u32s(0); PAIRED];
            for (pair, products) in (1..).zip(others) {
                let (products, pair) =
                    (&vectors::<S>(products).as_chunks::<PAIRED>().0[part], simd.splat_u32s(pair));
                for i in 0..PAIRED {
                    // What is not a number is never passed over.
                    let number = simd.equal_f32s(products[i], products[i]);
                    let larger = simd.greater_than_f32s(products[i], largest[i]);
                    let larger = simd.or_m32s(larger, simd.not_m32s(number));
                    largest[i] = select(simd, larger, products[i], largest[i]);
                    places[i] = simd.select_u32s(larger, pair, places[i]);
                }
            }
            (*values, *picks) = (largest, places);
        }
    }
}

/// The gradient before the ReLU of a pair that has the maximum of `channels`.
#[inline(always)]
fn before_relu<S: Simd>(
    simd: S,
    (channels, grad): (&[u8], &Row),
    last: &[Row],
    hidden: &Row,
    mut each_chunk: impl FnMut(usize, [S::f32s; CHUNK]),
) {
    let zero = simd.splat_f32s(0.0);
    for (chunk, hidden) in chunks::<S>(hidden).iter().enumerate() {
        let mut sums = [zero; CHUNK];
        for &c in channels {
            let (row, grad) =
                (&chunks::<S>(&last[usize::from(c)])[chunk], simd.splat_f32s(grad[usize::from(c)]));
            for (sum, weight) in sums.iter_mut().zip(row) {
                *sum = simd.mul_add_e_f32s(grad, *weight, *sum);
            }
        }
        for (sum, hidden) in sums.iter_mut().zip(hidden) {
            *sum = select(simd, simd.greater_than_f32s(*hidden, zero), *sum, zero);
        }
        each_chunk(chunk, sums);
    }
}

/// Gradients of a block's anchors, but for that of `other`.
pub(super) struct Gradient<'a> {
    pub(super) pairs: Pairs<'a>,
    /// W₂.
    pub(super) last: &'a [Row],
    pub(super) first: usize,
    pub(super) maxima: &'a Maxima,
    /// Of the maxima.
    pub(super) grad: &'a [Row],
    /// Added to: gradient of `own`, or nothing.
    pub(super) own: &'a mut [Row],
    /// Added to: gradient of `last`.
    pub(super) last_sum: &'a mut [Row],
    /// Added to: gradient of P by columns.
    pub(super) position_sum: &'a mut [Row; 3],
}

impl WithSimd for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pairs, last, first, maxima, grad, own: own_grads, last_sum, position_sum } = self;
        let mut hidden = [0.0; WIDTH];
        for (row, grad) in grad.iter().enumerate() {
            let i = first + row;
            let mut own_grad = own_grads.get_mut(row);
            for (place, channels) in maxima.of(row, pairs.each()).enumerate() {
                if channels.is_empty() {
                    continue;
                }
                let seen = pairs.seen(i, place);
                pairs.hidden(simd, i, seen, &mut hidden);
                add_to_last(simd, (channels, grad), &hidden, last_sum);
                let relative = seen.1.map(|v| simd.splat_f32s(v));
                before_relu(
                    simd,
                    (channels, grad),
                    last,
                    &hidden,
                    #[inline(always)]
                    |chunk, sums| {
                        if let Some(out) = &mut own_grad {
                            add(simd, &mut chunks_mut::<S>(out)[chunk], sums);
                        }
                        for (column, v) in position_sum.iter_mut().zip(relative) {
                            for (sum, grad) in chunks_mut::<S>(column)[chunk].iter_mut().zip(sums) {
                                *sum = simd.mul_add_e_f32s(v, grad, *sum);
                            }
                        }
                    },
                );
            }
        }
    }
}

/// Adds a pair's part to the gradient of W₂.
#[inline(always)]
fn add_to_last<S: Simd>(simd: S, (channels, grad): (&[u8], &Row), hidden: &Row, sums: &mut [Row]) {
    for &c in channels {
        let (sum, grad) = (&mut sums[usize::from(c)], simd.splat_f32s(grad[usize::from(c)]));
        for (sum, hidden) in vectors_mut::<S>(sum).iter_mut().zip(vectors::<S>(hidden)) {
            *sum = simd.mul_add_e_f32s(grad, *hidden, *sum);
        }
    }
}

/// Gradients of `other` of the anchors from `first` on, from those that look at them.
pub(super) struct Gather<'a> {
    pub(super) pairs: Pairs<'a>,
    /// W₂.
    pub(super) last: &'a [Row],
    pub(super) first: usize,
    pub(super) kept: Kept<'a, Sent>,
    pub(super) out: &'a mut [Row],
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pairs, last, first, kept, out } = self;
        let mut hidden = [0.0; WIDTH];
        for (row, out) in out.iter_mut().enumerate() {
            *out = [0.0; WIDTH];
            for (i, place) in kept.lookers.of(first + row) {
                let row = i % BLOCK;
                let channels = kept.maxima_of(i).of_pair(row, pairs.each(), place);
                if channels.is_empty() {
                    continue;
                }
                let grad = &each(&kept.sent_by(i).grad)[row];
                pairs.hidden(simd, i, pairs.seen(i, place), &mut hidden);
                before_relu(
                    simd,
                    (channels, grad),
                    last,
                    &hidden,
                    #[inline(always)]
                    |chunk, sums| add(simd, &mut chunks_mut::<S>(out)[chunk], sums),
                );
            }
        }
    }
}

#[inline(always)]
fn add<S: Simd>(simd: S, to: &mut [S::f32s; CHUNK], sums: [S::f32s; CHUNK]) {
    for (to, sum) in to.iter_mut().zip(sums) {
        *to = simd.add_f32s(*to, sum);
    }
}

/// A row in vectors, which divide it without rest.
#[inline(always)]
fn vectors<S: Simd>(row: &Row) -> &[S::f32s] {
    S::as_simd_f32s(row).0
}

#[inline(always)]
fn vectors_mut<S: Simd>(row: &mut Row) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(row).0
}

/// A row in chunks of vectors, which divide it without rest.
#[inline(always)]
fn chunks<S: Simd>(row: &Row) -> &[[S::f32s; CHUNK]] {
    vectors::<S>(row).as_chunks().0
}

#[inline(always)]
fn chunks_mut<S: Simd>(row: &mut Row) -> &mut [[S::f32s; CHUNK]] {
    vectors_mut::<S>(row).as_chunks_mut().0
}
