//! The lists of a block by AVX2: candidates within reach are packed without branches, and every [`RUN`] of them are
//! sorted by a network in registers and merged into the nearest so far.
#![allow(
    unsafe_code,
    reason = "vector loads and stores take pointers; calls need the processor to have AVX2"
)]

mod network;
mod vector;

use crate::search::{Lists, NO_CANDIDATE, split_key};
use crate::tree::{Bounds, LEAF, Leaf};
use cpu_isa::Isa;
use network::{RUN, Run};
use std::arch::x86_64::*;
use vector::{LANES, load, load_u32, pack, set_u32, squared_norm, store, store_u32};

const _: () = assert!(LEAF == RUN, "the points of a leaf fill the registers of the network");

/// Up to this `k` merging into sorted runs is faster than [`crate::candidates::Candidates`], which takes the same
/// time per candidate whatever `k` is.
const LARGEST_K: usize = 256;

/// Candidates of one query that are not yet among its nearest. Less than a run between two leaves.
#[derive(Clone)]
#[repr(C, align(32))]
struct Waiting {
    sq_distances: [f32; 2 * RUN],
    indices: [u32; 2 * RUN],
    len: usize,
}

/// See the module. It exists only where the processor has AVX2.
pub(crate) struct Avx2Lists {
    block: Leaf,
    block_len: usize,
    k: usize,
    /// The `k`-th key of each query; 0 where there is none.
    last: [u64; LEAF],
    /// Its distance.
    bound: [f32; LEAF],
    waiting: Vec<Waiting>,
    /// `[LEAF, runs]`: the nearest so far of each query, sorted.
    nearest: Vec<Run>,
    runs: usize,
}

impl Avx2Lists {
    pub(crate) fn serves(k: usize) -> bool {
        k <= LARGEST_K && Isa::in_use() >= Isa::Avx2
    }

    /// # Panics
    /// If it does not serve `k` on this processor.
    pub(crate) fn new(k: usize) -> Self {
        assert!(Self::serves(k), "k = {k}, at most {LARGEST_K} on a processor with AVX2");
        let runs = k.div_ceil(RUN);
        let none = Waiting { sq_distances: [0.0; 2 * RUN], indices: [0; 2 * RUN], len: 0 };
        Self {
            block: Leaf::EMPTY,
            block_len: 0,
            k,
            last: [NO_CANDIDATE; LEAF],
            bound: [f32::INFINITY; LEAF],
            waiting: vec![none; LEAF],
            nearest: vec![Run::EMPTY; LEAF * runs],
            runs,
        }
    }

    /// The lanes whose bound is beyond a box, and those whose bound it just touches.
    #[target_feature(enable = "avx2,popcnt")]
    fn within_reach(&self, bounds: &Bounds) -> (u32, u32) {
        let (mut closer, mut touching) = (0u32, 0u32);
        for start in (0..LEAF).step_by(LANES) {
            // As `Bounds::lowest_key_of`.
            let gap = |q: &[f32; LEAF], axis: usize| {
                let q = load(&q[start..]);
                let above = _mm256_sub_ps(_mm256_set1_ps(bounds.lo[axis]), q);
                let below = _mm256_sub_ps(q, _mm256_set1_ps(bounds.hi[axis]));
                _mm256_max_ps(_mm256_max_ps(above, below), _mm256_setzero_ps())
            };
            let to_box = squared_norm(gap(&self.block.x, 0), gap(&self.block.y, 1), gap(&self.block.z, 2));
            let bound = load(&self.bound[start..]);
            closer |= (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(to_box, bound)) as u32) << start;
            touching |= (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(to_box, bound)) as u32) << start;
        }
        let queries = u32::MAX >> (LEAF - self.block_len);
        (closer & queries, touching & queries)
    }

    #[target_feature(enable = "avx2,popcnt")]
    fn offer_leaf(&mut self, leaf: &Leaf, bounds: &Bounds) -> bool {
        let (closer, touching) = self.within_reach(bounds);
        let mut full = 0u32;
        for lane in lanes_of(closer) {
            full |= u32::from(self.offer_points::<false>(lane, leaf)) << lane;
        }
        for lane in lanes_of(touching) {
            if bounds.min_index < split_key(self.last[lane]).1 {
                full |= u32::from(self.offer_points::<true>(lane, leaf)) << lane;
            }
        }
        // Only now: a load that overlaps several stores waits until all of them have reached the cache.
        for lane in lanes_of(full) {
            self.merge(lane);
        }
        full != 0
    }

    /// Squared distances from a query to eight points.
    #[target_feature(enable = "avx2,popcnt")]
    #[inline]
    fn sq_distances(&self, lane: usize, leaf: &Leaf, start: usize) -> __m256 {
        let from =
            |p: &[f32; LEAF], q: &[f32; LEAF]| _mm256_sub_ps(load(&p[start..]), _mm256_set1_ps(q[lane]));
        squared_norm(from(&leaf.x, &self.block.x), from(&leaf.y, &self.block.y), from(&leaf.z, &self.block.z))
    }

    /// Takes what is within the bound; says whether a run waits. With `TIES_ONLY` no point is below the bound, and at
    /// the bound only lower indices than that of the `k`-th are taken: at zero or infinity a leaf may be all ties.
    #[target_feature(enable = "avx2,popcnt")]
    fn offer_points<const TIES_ONLY: bool>(&mut self, lane: usize, leaf: &Leaf) -> bool {
        let bound = _mm256_set1_ps(self.bound[lane]);
        let last_index = set_u32(split_key(self.last[lane]).1);
        let mut len = self.waiting[lane].len;
        for start in (0..LEAF).step_by(LANES) {
            let sq_distances = self.sq_distances(lane, leaf, start);
            let indices = load_u32(&leaf.index[start..]);
            let mut near = _mm256_cmp_ps::<_CMP_LE_OQ>(sq_distances, bound);
            if TIES_ONLY {
                let not_lower = _mm256_cmpeq_epi32(_mm256_max_epu32(indices, last_index), indices);
                near = _mm256_andnot_ps(_mm256_castsi256_ps(not_lower), near);
            }
            let near = _mm256_movemask_ps(near) as u8;
            let waiting = &mut self.waiting[lane];
            let (sq_distances, indices) = pack(sq_distances, indices, near);
            store(&mut waiting.sq_distances[len..], sq_distances);
            store_u32(&mut waiting.indices[len..], indices);
            len += near.count_ones() as usize;
        }
        self.waiting[lane].len = len;
        len >= RUN
    }

    /// Moves a run of those that wait, or all if they are fewer, to the nearest.
    #[target_feature(enable = "avx2,popcnt")]
    fn merge(&mut self, lane: usize) {
        let waiting = &mut self.waiting[lane];
        let (infinity, none) = (_mm256_set1_ps(f32::INFINITY), set_u32(u32::MAX));
        let mut keys = Run::EMPTY.load();
        for register in 0..RUN / LANES {
            let place = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            let filled = _mm256_cmpgt_epi32(
                set_u32((waiting.len - (register * LANES).min(waiting.len)) as u32),
                place,
            );
            let sq_distances = load(&waiting.sq_distances[register * LANES..]);
            let sq_distances = _mm256_blendv_ps(infinity, sq_distances, _mm256_castsi256_ps(filled));
            let indices = _mm256_blendv_epi8(none, load_u32(&waiting.indices[register * LANES..]), filled);
            (keys[2 * register], keys[2 * register + 1]) = network::keys(sq_distances, indices);
        }
        let rest = waiting.len.saturating_sub(RUN);
        for start in (0..rest).step_by(LANES) {
            let sq_distances = load(&waiting.sq_distances[RUN + start..]);
            let indices = load_u32(&waiting.indices[RUN + start..]);
            store(&mut waiting.sq_distances[start..], sq_distances);
            store_u32(&mut waiting.indices[start..], indices);
        }
        waiting.len = rest;
        let mut new = network::sort(keys);
        let nearest = &mut self.nearest[lane * self.runs..][..self.runs];
        let (farthest, nearer) = nearest.split_last_mut().expect("k > 0");
        for run in nearer {
            let (low, high) = network::merge(run.load(), new);
            run.store(low);
            new = high;
        }
        farthest.store(network::merge_low(farthest.load(), new));
        self.update_bound(lane);
    }

    #[target_feature(enable = "avx2,popcnt")]
    fn highest_last(&self) -> u64 {
        // Loops without end conditions of their own are vectorized.
        let mut highest = [0; 4];
        for last in self.last.as_chunks::<4>().0 {
            for (highest, &last) in highest.iter_mut().zip(last) {
                *highest = last.max(*highest);
            }
        }
        highest.into_iter().fold(0, u64::max)
    }

    fn update_bound(&mut self, lane: usize) {
        let last = self.nearest[lane * self.runs + (self.k - 1) / RUN].key((self.k - 1) % RUN);
        (self.last[lane], self.bound[lane]) = (last, split_key(last).0);
    }

    #[target_feature(enable = "avx2,popcnt")]
    fn offer_block(&mut self) {
        for lane in 0..self.block_len {
            let own_index = set_u32(self.block.index[lane]);
            let infinity = _mm256_set1_ps(f32::INFINITY);
            let mut keys = Run::EMPTY.load();
            for register in 0..RUN / LANES {
                // Of a NaN, where there is no point, and another number the minimum is the second.
                let sq_distances =
                    _mm256_min_ps(self.sq_distances(lane, &self.block, register * LANES), infinity);
                let indices = load_u32(&self.block.index[register * LANES..]);
                let itself = _mm256_cmpeq_epi32(indices, own_index);
                let sq_distances = _mm256_blendv_ps(sq_distances, infinity, _mm256_castsi256_ps(itself));
                let indices = _mm256_or_si256(indices, itself);
                (keys[2 * register], keys[2 * register + 1]) = network::keys(sq_distances, indices);
            }
            self.nearest[lane * self.runs].store(network::sort(keys));
            self.update_bound(lane);
        }
    }

    #[target_feature(enable = "avx2,popcnt")]
    fn finish_lane(&mut self, lane: usize, indices: &mut [u32], sq_distances: &mut [f32]) {
        if self.waiting[lane].len > 0 {
            self.merge(lane);
        }
        let runs = &self.nearest[lane * self.runs..][..self.runs];
        let rows = indices.chunks_mut(RUN).zip(sq_distances.chunks_mut(RUN));
        for (run, (indices, sq_distances)) in runs.iter().zip(rows) {
            let sorted = network::in_order(run.load());
            let places = indices.chunks_mut(LANES).zip(sq_distances.chunks_mut(LANES));
            for ((i, d), (indices, sq_distances)) in sorted.into_iter().zip(places) {
                if indices.len() == LANES {
                    store_u32(indices, i);
                    store(sq_distances, d);
                } else {
                    let (mut all_indices, mut all_sq_distances) = ([0; LANES], [0.0; LANES]);
                    store_u32(&mut all_indices, i);
                    store(&mut all_sq_distances, d);
                    indices.copy_from_slice(&all_indices[..indices.len()]);
                    sq_distances.copy_from_slice(&all_sq_distances[..sq_distances.len()]);
                }
            }
        }
    }
}

/// The set bits of a mask.
fn lanes_of(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (lane < LEAF).then_some(lane)
    })
}

impl Lists for Avx2Lists {
    fn begin(&mut self, block: &Leaf, len: usize) {
        (self.block, self.block_len) = (block.clone(), len);
        self.last = [0; LEAF];
        self.last[..len].fill(NO_CANDIDATE);
        self.bound = [f32::INFINITY; LEAF];
        self.nearest.fill(Run::EMPTY);
        for waiting in &mut self.waiting {
            waiting.len = 0;
        }
    }

    fn offer_own(&mut self) {
        // SAFETY: `new` has found AVX2.
        unsafe { self.offer_block() }
    }

    fn offer(&mut self, leaf: &Leaf, bounds: &Bounds) -> bool {
        // SAFETY: `new` has found AVX2.
        unsafe { self.offer_leaf(leaf, bounds) }
    }

    fn last(&self) -> u64 {
        // SAFETY: `new` has found AVX2.
        unsafe { self.highest_last() }
    }

    fn finish(&mut self, lane: usize, indices: &mut [u32], sq_distances: &mut [f32]) {
        // SAFETY: `new` has found AVX2.
        unsafe { self.finish_lane(lane, indices, sq_distances) }
    }
}
