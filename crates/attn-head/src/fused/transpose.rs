//! The transposed neighbour lists: for each anchor, the anchors that it is a neighbour of.

use super::pairs::{SUMS, TwoRows};
use crate::{HEAD_WIDTH, HEADS, Inputs};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Isa, dispatch};

/// For every anchor those that have it as a neighbour, in ascending order.
#[derive(Debug)]
pub(super) struct Lookers {
    /// Where each anchor's part of `pairs` begins, and the last one's ends.
    starts: Vec<usize>,
    /// Places in `Inputs::neighbours`.
    pairs: Vec<usize>,
    k: usize,
}

impl Lookers {
    pub(super) fn new(inputs: &Inputs<'_>) -> Self {
        let mut starts = vec![0; inputs.n + 1];
        for &j in inputs.neighbours {
            starts[j as usize + 1] += 1;
        }
        for j in 0..inputs.n {
            starts[j + 1] += starts[j];
        }
        let mut next = starts.clone();
        let mut pairs = vec![0; inputs.neighbours.len()];
        for (pair, &j) in inputs.neighbours.iter().enumerate() {
            pairs[next[j as usize]] = pair;
            next[j as usize] += 1;
        }
        Self { starts, pairs, k: inputs.k }
    }

    /// Those who look at `anchor`, itself first, and the place of the pair among `[n, k + 1]`.
    #[inline(always)]
    fn of(&self, anchor: usize) -> impl Iterator<Item = (usize, usize)> {
        let others = self.pairs[self.starts[anchor]..self.starts[anchor + 1]].iter();
        let place = |&pair: &usize| (pair / self.k, pair + pair / self.k + 1);
        std::iter::once((anchor, anchor * (self.k + 1))).chain(others.map(place))
    }
}

/// What every anchor sends to those it looks at, see [`super::layer::Sent`].
#[derive(Debug, Clone, Copy)]
pub(super) struct AllSent<'a> {
    pub(super) alphas: &'a [[f32; HEADS]],
    pub(super) logits: &'a [[f32; HEADS]],
    pub(super) rows: &'a [TwoRows],
}

/// Gradients of the keys and values of the anchors from `first` on.
pub(super) fn gather(isa: Isa, sent: AllSent<'_>, lookers: &Lookers, first: usize, out: &mut [TwoRows]) {
    dispatch(isa, Gather { sent, lookers, first, out });
}

struct Gather<'a> {
    sent: AllSent<'a>,
    lookers: &'a Lookers,
    first: usize,
    out: &'a mut [TwoRows],
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { sent, lookers, first, out } = self;
        let per_part = HEAD_WIDTH / S::F32_LANES;
        let mut parts: Vec<(&TwoRows, [f32; 2 * HEADS])> = Vec::new();
        for (j, out) in out.iter_mut().enumerate() {
            parts.clear();
            parts.extend(lookers.of(first + j).map(|(i, pair)| {
                // A logit has the key with the sign minus.
                let (alpha, logit) = (sent.alphas[pair], sent.logits[pair]);
                let weight = |c: usize| if c < HEADS { -logit[c] } else { alpha[c - HEADS] };
                (&sent.rows[i], std::array::from_fn(weight))
            }));
            let out = S::as_mut_simd_f32s(out).0.as_chunks_mut::<SUMS>().0;
            for (chunk, out) in out.iter_mut().enumerate() {
                let mut sums = [simd.splat_f32s(0.0); SUMS];
                for (row, weights) in &parts {
                    let row = &S::as_simd_f32s(*row).0.as_chunks::<SUMS>().0[chunk];
                    for (i, sum) in sums.iter_mut().enumerate() {
                        let weight = simd.splat_f32s(weights[(chunk * SUMS + i) / per_part]);
                        *sum = simd.mul_add_e_f32s(weight, row[i], *sum);
                    }
                }
                *out = sums;
            }
        }
    }
}
