//! Splats near to far; equal depths in the order of the scene.
//!
//! One sort for the whole picture instead of one per tile: a splat is in several tiles. First into buckets of
//! neighbouring depths, each chunk on its own, then each bucket is sorted on its own.

use super::project::{CHUNK, Splats};
use rayon::prelude::*;

/// Buckets of depth, at most; so many that few splats share one.
const BUCKETS: usize = 4096;
/// Chunks of splats that are put into buckets together.
const CHUNKS: usize = 4;
/// Buckets per task of the second step.
const TASK: usize = 64;

/// The indices of splats near to far, and the memory to find them.
#[derive(Debug, Default)]
pub(super) struct Order {
    indices: Vec<u32>,
    parts: Vec<Part>,
}

/// Keys of some chunks by bucket; within a bucket in the order of the scene.
#[derive(Debug, Default)]
struct Part {
    /// Where each bucket ends in `keys`; it starts where the one before ends.
    ends: Vec<u32>,
    /// The bits of the depth in the high half, the index in the low half.
    keys: Vec<u64>,
}

impl Order {
    /// Near to far.
    pub(super) fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// Sorts `splats`; what was here is forgotten.
    pub(super) fn sort(&mut self, splats: &Splats) {
        let (least, most) = splats
            .depths()
            .map(|chunk| {
                chunk.iter().fold((u32::MAX, 0), |(least, most), &bits| (bits.min(least), bits.max(most)))
            })
            .reduce(|| (u32::MAX, 0), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let range = most.saturating_sub(least);
        let shift = (u32::BITS - range.leading_zeros()).saturating_sub(BUCKETS.ilog2());
        let bucket = |bits: u32| ((bits - least) >> shift) as usize;

        let chunks: Vec<_> = splats.depths().collect();
        self.parts.resize_with(chunks.len().div_ceil(CHUNKS), Part::default);
        self.parts.par_iter_mut().zip(chunks.par_chunks(CHUNKS)).enumerate().for_each(
            |(part, (buckets, chunks))| {
                let Part { ends, keys } = buckets;
                ends.clear();
                ends.resize(BUCKETS, 0);
                for &bits in chunks.iter().copied().flatten() {
                    ends[bucket(bits)] += 1;
                }
                let mut total = 0;
                for end in &mut *ends {
                    (*end, total) = (total, total + *end);
                }
                keys.resize(total as usize, 0);
                for (chunk, depths) in chunks.iter().enumerate() {
                    let first = ((part * CHUNKS + chunk) * CHUNK) as u32;
                    for (index, &bits) in (first..).zip(*depths) {
                        let place = &mut ends[bucket(bits)];
                        keys[*place as usize] = u64::from(bits) << 32 | u64::from(index);
                        *place += 1;
                    }
                }
            },
        );

        self.indices.resize(self.parts.iter().map(|part| part.keys.len()).sum(), 0);
        let mut rest = self.indices.as_mut_slice();
        let mut tasks = Vec::with_capacity(BUCKETS / TASK);
        for first in (0..BUCKETS).step_by(TASK) {
            let count = self.parts.iter().map(|part| part.range(first, first + TASK).len()).sum();
            let (here, after) = rest.split_at_mut(count);
            rest = after;
            tasks.push((first, here));
        }
        let parts = &self.parts;
        tasks.into_par_iter().for_each_init(Vec::new, |keys: &mut Vec<u64>, (first, indices)| {
            let mut start = 0;
            for bucket in first..first + TASK {
                keys.clear();
                for part in parts {
                    keys.extend_from_slice(&part.keys[part.range(bucket, bucket + 1)]);
                }
                keys.sort_unstable();
                for (index, key) in indices[start..].iter_mut().zip(&*keys) {
                    *index = *key as u32;
                }
                start += keys.len();
            }
        });
    }
}

impl Part {
    /// Where the keys of the buckets from `first` to before `end` are.
    fn range(&self, first: usize, end: usize) -> std::ops::Range<usize> {
        let start = if first == 0 { 0 } else { self.ends[first - 1] as usize };
        start..self.ends[end - 1] as usize
    }
}
