//! Attention on slices: the scores of a block of queries and one head at a time, never all of them.

use cpu_kernels::rows::exponentials;
use cpu_kernels::{Isa, Packed, Rows, multiply};
use rayon::prelude::*;

/// Scores per block: they stay in the second-level cache.
const SCORES: usize = 1 << 16;

/// Where the vectors of the heads lie: value c of head h of token t at `values[t * stride + first + h * step + c]`.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Heads<'a> {
    pub(in crate::depthsplat) values: &'a [f32],
    pub(in crate::depthsplat) stride: usize,
    pub(in crate::depthsplat) first: usize,
    pub(in crate::depthsplat) step: usize,
}

impl<'a> Heads<'a> {
    /// `count` tokens from `first` on, `width` channels of a head.
    fn rows(&self, head: usize, (first, count): (usize, usize), width: usize) -> Rows<'a> {
        let start = first * self.stride + self.first + head * self.step;
        Rows::strided(&self.values[start..], count, width, self.stride)
    }
}

/// Tokens with different labels hardly see each other: -100 is added to their score.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Labels<'a> {
    /// `[sets, queries]`.
    pub(in crate::depthsplat) queries: &'a [f32],
    /// `[sets, keys]`.
    pub(in crate::depthsplat) keys: &'a [f32],
}

/// Groups of queries, each of which attends to the keys of its own group.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Attention<'a> {
    pub(in crate::depthsplat) q: Heads<'a>,
    pub(in crate::depthsplat) k: Heads<'a>,
    pub(in crate::depthsplat) v: Heads<'a>,
    pub(in crate::depthsplat) groups: usize,
    /// Queries per group.
    pub(in crate::depthsplat) queries: usize,
    /// Keys per group.
    pub(in crate::depthsplat) keys: usize,
    pub(in crate::depthsplat) heads: usize,
    /// Channels per head.
    pub(in crate::depthsplat) width: usize,
    /// Factor of the scores.
    pub(in crate::depthsplat) scale: f32,
    /// Group g uses set g modulo their number.
    pub(in crate::depthsplat) labels: Option<Labels<'a>>,
}

/// softmax(scale q kᵀ + mask) v, `[groups, queries, heads, width]`.
pub(in crate::depthsplat) fn attend(a: &Attention<'_>) -> Vec<f32> {
    let row = a.heads * a.width;
    let mut out = vec![0.0; a.groups * a.queries * row];
    let isa = Isa::in_use();
    let block = (SCORES / a.keys).clamp(24, 96) / 24 * 24;
    out.par_chunks_mut(a.queries * row).enumerate().for_each(|(group, out)| {
        let packed: Vec<(Packed, Packed)> =
            (0..a.heads).into_par_iter().map(|head| pack(isa, a, group, head)).collect();
        out.par_chunks_mut(block * row).enumerate().for_each_init(Vec::new, |scores, (b, out)| {
            for (head, (k, v)) in packed.iter().enumerate() {
                let count = out.len() / row;
                let queries = a.q.rows(head, (group * a.queries + b * block, count), a.width);
                head_block(a, (queries, k, v), (group, b * block), scores, &mut out[head * a.width..]);
            }
        });
    });
    out
}

/// Keys `[width, keys]` and values `[keys, width]` of a head.
fn pack(isa: Isa, a: &Attention<'_>, group: usize, head: usize) -> (Packed, Packed) {
    let tokens = (group * a.keys, a.keys);
    let (k, v) = (a.k.rows(head, tokens, a.width), a.v.rows(head, tokens, a.width));
    (Packed::transposed(isa, k), Packed::rows(isa, v))
}

fn head_block(
    a: &Attention<'_>,
    (queries, k, v): (Rows<'_>, &Packed, &Packed),
    (group, first): (usize, usize),
    scores: &mut Vec<f32>,
    out: &mut [f32],
) {
    let count = queries.count();
    scores.resize(count * a.keys, 0.0);
    multiply(queries, k, scores, a.keys, false);
    let labels = a.labels.map(|labels| {
        let set = group % (labels.queries.len() / a.queries);
        let queries = &labels.queries[set * a.queries + first..][..count];
        (queries, &labels.keys[set * a.keys..][..a.keys])
    });
    let mut sums = vec![0.0; count];
    for (i, (row, sum)) in scores.chunks_exact_mut(a.keys).zip(&mut sums).enumerate() {
        let labels = labels.map(|(queries, keys)| (queries[i], keys));
        *sum = exponentials(k.isa(), row, a.scale, labels);
    }
    let row = a.heads * a.width;
    multiply(Rows::new(scores, count, a.keys), v, out, row, false);
    for (i, sum) in sums.iter().enumerate() {
        out[i * row..][..a.width].iter_mut().for_each(|v| *v /= sum);
    }
}

/// softmax along rows of `channels`, in place.
pub(in crate::depthsplat) fn softmax_rows(values: &mut [f32], channels: usize) {
    let isa = Isa::in_use();
    values.par_chunks_mut(channels * 64).for_each(|rows| {
        for row in rows.chunks_exact_mut(channels) {
            let sum = exponentials(isa, row, 1.0, None);
            row.iter_mut().for_each(|v| *v /= sum);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn attention_agrees_with_the_definition(
            (groups, queries, keys) in (1_usize..4, 1_usize..40, 1_usize..70),
            (heads, width) in (1_usize..4, 1_usize..20),
            labelled: bool,
            seed: u32,
        ) {
            let value = |i: usize| {
                let mixed = (i as u32 ^ seed).wrapping_mul(2_654_435_761);
                ((mixed ^ (mixed >> 15)) >> 8) as f32 / 4_194_304.0 - 2.0
            };
            // q in its own rows, k and v interleaved in common ones.
            let q: Vec<f32> = (0..groups * queries * heads * width).map(value).collect();
            let kv: Vec<f32> = (0..groups * keys * heads * width * 2).map(|i| value(i + 31_337)).collect();
            let (q_labels, k_labels): (Vec<f32>, Vec<f32>) = (
                (0..2 * queries).map(|i| (i % 3) as f32).collect(),
                (0..2 * keys).map(|i| (i % 5 % 3) as f32).collect(),
            );
            let stride = heads * width * 2;
            let a = Attention {
                q: Heads { values: &q, stride: heads * width, first: 0, step: width },
                k: Heads { values: &kv, stride, first: 0, step: 2 * width },
                v: Heads { values: &kv, stride, first: width, step: 2 * width },
                groups, queries, keys, heads, width, scale: 0.7,
                labels: labelled.then_some(Labels { queries: &q_labels, keys: &k_labels }),
            };
            let found = attend(&a);
            for (group, query, head) in (0..groups * queries * heads)
                .map(|i| (i / heads / queries, i / heads % queries, i % heads))
            {
                let component = |key: usize, c: usize| f64::from(kv[(group * keys + key) * stride + head * 2 * width + c]);
                let mine = &q[((group * queries + query) * heads + head) * width..][..width];
                let weights: Vec<f64> = (0..keys).map(|key| {
                    let dot: f64 = mine.iter().enumerate().map(|(c, &v)| f64::from(v) * component(key, c)).sum();
                    let set = group % 2;
                    let apart = labelled && q_labels[set * queries + query] != k_labels[set * keys + key];
                    (0.7 * dot - if apart { 100.0 } else { 0.0 }).exp()
                }).collect();
                let total: f64 = weights.iter().sum();
                for c in 0..width {
                    let sum: f64 = weights.iter().enumerate().map(|(key, w)| w * component(key, width + c)).sum();
                    let found = f64::from(found[((group * queries + query) * heads + head) * width + c]);
                    prop_assert!((found - sum / total).abs() < 3e-5, "{} and {}", found, sum / total);
                }
            }
        }
    }

    #[test]
    fn huge_scores_do_not_overflow() {
        let mut row = vec![1e30, -1e30, 1e30, 0.0];
        softmax_rows(&mut row, 4);
        assert!(row[0] == 0.5 && row[2] == 0.5 && row[1].max(row[3]) < 1e-37, "{row:?}");
    }
}
