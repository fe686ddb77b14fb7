//! The lists of a block for any `k` and any processor.

use crate::search::{Lists, NO_CANDIDATE, key, split_key};
use crate::tree::{Bounds, LEAF, Leaf};

/// The nearest keys so far of each query of a block. New ones collect behind the `k` nearest until there are enough
/// to pay for a selection: constant time per candidate for any `k`, where keeping them sorted would take O(k).
pub(crate) struct Candidates {
    block: Leaf,
    block_len: usize,
    k: usize,
    /// Keys per query for which there is room.
    capacity: usize,
    /// `[LEAF, capacity]`, the first `len` of each in use.
    keys: Vec<u64>,
    len: [usize; LEAF],
    /// Keys above this are not among the `k` nearest; as of the latest selection.
    last: [u64; LEAF],
}

impl Candidates {
    pub(crate) fn new(k: usize) -> Self {
        let capacity = k + (k / 4).max(16) + LEAF;
        Self {
            block: Leaf::EMPTY,
            block_len: 0,
            k,
            capacity,
            keys: vec![0; LEAF * capacity],
            len: [0; LEAF],
            last: [NO_CANDIDATE; LEAF],
        }
    }

    /// Adds keys, at most [`LEAF`]; says whether the bound moved.
    fn extend(&mut self, lane: usize, new: impl Iterator<Item = u64>) -> bool {
        let keys = &mut self.keys[lane * self.capacity..][..self.capacity];
        let mut len = self.len[lane];
        for key in new {
            keys[len] = key;
            len += 1;
        }
        let first_bound = len >= self.k && self.last[lane] == NO_CANDIDATE;
        let select = first_bound || len + LEAF > self.capacity;
        if select {
            self.last[lane] = *keys[..len].select_nth_unstable(self.k - 1).1;
            len = self.k;
        }
        self.len[lane] = len;
        select
    }

    /// Offers the points of a leaf to one query, to itself if it is its own.
    fn offer_points(&mut self, lane: usize, leaf: &Leaf, is_own: bool) -> bool {
        let (qx, qy, qz) = (self.block.x[lane], self.block.y[lane], self.block.z[lane]);
        let mut sq_distances = [0f32; LEAF];
        for (i, sq_distance) in sq_distances.iter_mut().enumerate() {
            let (dx, dy, dz) = (leaf.x[i] - qx, leaf.y[i] - qy, leaf.z[i] - qz);
            *sq_distance = dx * dx + dy * dy + dz * dz;
        }
        if is_own {
            sq_distances[lane] = f32::NAN;
        }
        let (bound, last_index) = split_key(self.last[lane]);
        let mut near = 0u32;
        for (i, &sq_distance) in sq_distances.iter().enumerate() {
            // At the bound only lower indices enter; at infinity that keeps the others out from the start.
            let enters = (sq_distance < bound) | (sq_distance == bound) & (leaf.index[i] < last_index);
            near |= u32::from(enters) << i;
        }
        let new = std::iter::from_fn(|| {
            let i = near.trailing_zeros() as usize;
            near &= near.wrapping_sub(1);
            (i < LEAF).then(|| key(sq_distances[i], leaf.index[i]))
        });
        self.extend(lane, new)
    }
}

impl Lists for Candidates {
    fn begin(&mut self, block: &Leaf, len: usize) {
        (self.block, self.block_len) = (block.clone(), len);
        self.len = [0; LEAF];
        self.last = [NO_CANDIDATE; LEAF];
    }

    fn offer_own(&mut self) {
        let block = self.block.clone();
        for lane in 0..self.block_len {
            self.offer_points(lane, &block, true);
        }
    }

    fn offer(&mut self, leaf: &Leaf, bounds: &Bounds) -> bool {
        let block = &self.block;
        let mut lowest = [0u64; LEAF];
        for (lane, lowest) in lowest.iter_mut().enumerate() {
            *lowest = bounds.lowest_key_of([block.x[lane], block.y[lane], block.z[lane]]);
        }
        let mut changed = false;
        for (lane, &lowest) in lowest.iter().enumerate().take(self.block_len) {
            if lowest <= self.last[lane] {
                changed |= self.offer_points(lane, leaf, false);
            }
        }
        changed
    }

    fn last(&self) -> u64 {
        self.last[..self.block_len].iter().copied().max().unwrap_or(0)
    }

    fn finish(&mut self, lane: usize, indices: &mut [u32], sq_distances: &mut [f32]) {
        let keys = &mut self.keys[lane * self.capacity..][..self.len[lane]];
        keys.select_nth_unstable(self.k - 1);
        let nearest = &mut keys[..self.k];
        nearest.sort_unstable();
        for ((&key, index), sq_distance) in nearest.iter().zip(indices).zip(sq_distances) {
            (*sq_distance, *index) = split_key(key);
        }
    }
}
