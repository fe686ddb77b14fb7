//! Gradients of keys and values, which an anchor gathers from those that look at it.

use super::Sent;
use super::pairs::{SUMS, TwoRows};
use crate::fused::message::Kept;
use crate::fused::network::BLOCK;
use crate::{HEAD_WIDTH, HEADS};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Isa, dispatch};

/// Gradients of the keys and values of the anchors from `first` on.
pub(super) fn gather(isa: Isa, kept: Kept<'_, Sent>, first: usize, out: &mut [TwoRows]) {
    dispatch(isa, Gather { kept, first, out });
}

struct Gather<'a> {
    kept: Kept<'a, Sent>,
    first: usize,
    out: &'a mut [TwoRows],
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { kept, first, out } = self;
        let per_part = HEAD_WIDTH / S::F32_LANES;
        let mut parts: Vec<(&TwoRows, [f32; 2 * HEADS])> = Vec::new();
        for (j, out) in out.iter_mut().enumerate() {
            parts.clear();
            parts.extend(kept.lookers.of(first + j).map(|(i, place)| {
                let (sent, row) = (kept.sent_by(i), i % BLOCK);
                let pair = row * (kept.lookers.k + 1) + place;
                // A logit has the key with the sign minus.
                let (alpha, logit) = (sent.alphas[pair], sent.logits[pair]);
                let weight = |c: usize| if c < HEADS { -logit[c] } else { alpha[c - HEADS] };
                (&sent.rows[row], std::array::from_fn(weight))
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
