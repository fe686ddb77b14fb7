//! Who looks at whom, the other way round.

use super::pairs::TwoRows;
use crate::{HEAD_WIDTH, HEADS, Inputs, WIDTH};
use multiversion::{multiversion, target::target_cfg_f};

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
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn gather(sent: AllSent, lookers: &Lookers, first: usize, out: &mut [TwoRows]) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        gather_with::<true>(sent, lookers, first, out);
    } else {
        gather_with::<false>(sent, lookers, first, out);
    }
}

#[inline(always)]
fn gather_with<const FMA: bool>(sent: AllSent<'_>, lookers: &Lookers, first: usize, out: &mut [TwoRows]) {
    use super::math::mul_add;
    for (j, out) in out.iter_mut().enumerate() {
        let mut sums = [0.0_f32; 2 * WIDTH];
        for (i, pair) in lookers.of(first + j) {
            let (row, alpha, logit) = (&sent.rows[i], sent.alphas[pair], sent.logits[pair]);
            // A logit has the key with the sign minus.
            for (part, weight) in logit.map(|v| -v).into_iter().chain(alpha).enumerate() {
                for d in part * HEAD_WIDTH..(part + 1) * HEAD_WIDTH {
                    sums[d] = mul_add::<FMA>(weight, row[d], sums[d]);
                }
            }
        }
        *out = sums;
    }
}
