//! All queries of a leaf are searched together: one walk through the tree serves [`LEAF`] of them.

use crate::tree::{LEAF, Leaf, Node, Tree};
use rayon::prelude::*;

/// A candidate as one integer: the bits of its squared distance above its index. Squared distances are at least
/// +0, and such floats order as their bits do, so that keys order by distance, then index, infinity included.
fn key(sq_distance: f32, index: u32) -> u64 {
    u64::from(sq_distance.to_bits()) << 32 | u64::from(index)
}

/// Squared distance and index of a key.
pub(crate) fn split_key(key: u64) -> (f32, u32) {
    (f32::from_bits((key >> 32) as u32), key as u32)
}

/// Above every key of a real point, below every NaN.
const NO_CANDIDATE: u64 = (f32::INFINITY.to_bits() as u64) << 32 | u32::MAX as u64;

/// The sorted keys of the `k` nearest points of every query, `[n_queries, k]` in the order of the leaves of
/// `queries`. There must be at least `k` points (`k + 1` with `exclude_self`, for which both trees are the same).
pub(crate) fn nearest_keys(points: &Tree, queries: &Tree, k: usize, exclude_self: bool) -> Vec<u64> {
    let n_queries = queries.leaves.iter().map(|leaf| leaf.len).sum::<usize>();
    let mut keys = vec![0; n_queries * k];
    keys.par_chunks_mut(LEAF * k).zip(&queries.leaves).enumerate().for_each_init(
        || Candidates::new(k),
        |candidates, (leaf_idx, (rows, block))| {
            candidates.clear();
            let own = exclude_self.then_some(leaf_idx);
            Search { points, block, around: bounding_box(block), candidates }.run(own);
            for (lane, row) in rows.chunks_exact_mut(k).enumerate() {
                row.copy_from_slice(candidates.sorted(lane));
            }
        },
    );
    keys
}

/// The nearest keys so far of each query of a block. New ones collect behind the `k` nearest until there are enough
/// to pay for a selection: constant time per candidate for any `k`, where keeping them sorted would take O(k).
struct Candidates {
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
    fn new(k: usize) -> Self {
        let capacity = k + (k / 4).max(16) + LEAF;
        Self { k, capacity, keys: vec![0; LEAF * capacity], len: [0; LEAF], last: [NO_CANDIDATE; LEAF] }
    }

    fn clear(&mut self) {
        self.len = [0; LEAF];
        self.last = [NO_CANDIDATE; LEAF];
    }

    /// Squared distance above which nothing can enter.
    fn bound(&self, lane: usize) -> f32 {
        split_key(self.last[lane]).0
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

    /// The `k` nearest keys.
    fn sorted(&mut self, lane: usize) -> &[u64] {
        let keys = &mut self.keys[lane * self.capacity..][..self.len[lane]];
        keys.select_nth_unstable(self.k - 1);
        let nearest = &mut keys[..self.k];
        nearest.sort_unstable();
        nearest
    }
}

struct Search<'a> {
    points: &'a Tree,
    block: &'a Leaf,
    /// Box of the block: lowest and highest coordinates.
    around: [[f32; 3]; 2],
    candidates: &'a mut Candidates,
}

impl Search<'_> {
    /// Depth first, nearer child first. `own` is the leaf that the block itself is.
    fn run(&mut self, own: Option<usize>) {
        let mut last = NO_CANDIDATE;
        let n_leaves = self.points.leaves.len();
        let mut stack = vec![(self.lower_bound(0), 0, 0, n_leaves)];
        while let Some((bound, node, first_leaf, n_leaves)) = stack.pop() {
            // A key below covers ties: where distances are equal, only a lower index would enter. Without it,
            // a set of equal points would make every block visit every leaf.
            if bound > last {
                continue;
            }
            if n_leaves == 1 {
                if self.visit(node, first_leaf, own == Some(first_leaf)) {
                    last = self.candidates.last[..self.block.len].iter().copied().max().unwrap_or(0);
                }
                continue;
            }
            let left_leaves = n_leaves / 2;
            let (left, right) = (node + 1, node + 2 * left_leaves);
            let left = (self.lower_bound(left), left, first_leaf, left_leaves);
            let right = (self.lower_bound(right), right, first_leaf + left_leaves, n_leaves - left_leaves);
            let (near, far) = if right.0 < left.0 { (right, left) } else { (left, right) };
            stack.push(far);
            stack.push(near);
        }
    }

    /// A key that no point below the node can undercut for any query of the block.
    ///
    /// Safe in f32: rounding is monotone, so for `q <= hi < lo <= p` the rounded `lo - hi` is at most the rounded
    /// `p - q`, and the same holds for squares and sums taken in the order of the true distance.
    fn lower_bound(&self, node: usize) -> u64 {
        let node = &self.points.nodes[node];
        let [lo, hi] = &self.around;
        let gap = |axis: usize| outside(node.lo[axis] - hi[axis], lo[axis] - node.hi[axis]);
        let (dx, dy, dz) = (gap(0), gap(1), gap(2));
        key(dx * dx + dy * dy + dz * dz, node.min_index)
    }

    /// Offers the points of a leaf to every query of the block whose bound reaches its box; says whether any bound
    /// moved.
    fn visit(&mut self, node: usize, leaf_idx: usize, is_own: bool) -> bool {
        let Node { lo, hi, .. } = self.points.nodes[node];
        let block = self.block;
        // As `lower_bound`, for each query alone.
        let mut to_box = [0f32; LEAF];
        for (lane, to_box) in to_box.iter_mut().enumerate() {
            let gap = |q: f32, axis: usize| outside(lo[axis] - q, q - hi[axis]);
            let (dx, dy, dz) = (gap(block.x[lane], 0), gap(block.y[lane], 1), gap(block.z[lane], 2));
            *to_box = dx * dx + dy * dy + dz * dz;
        }
        let mut changed = false;
        for (lane, &to_box) in to_box.iter().enumerate().take(block.len) {
            if to_box <= self.candidates.bound(lane) {
                changed |= self.offer(lane, leaf_idx, is_own);
            }
        }
        changed
    }

    /// Offers the points of a leaf to one query.
    fn offer(&mut self, lane: usize, leaf_idx: usize, is_own: bool) -> bool {
        let leaf = &self.points.leaves[leaf_idx];
        let (qx, qy, qz) = (self.block.x[lane], self.block.y[lane], self.block.z[lane]);
        let mut sq_distances = [0f32; LEAF];
        for (i, sq_distance) in sq_distances.iter_mut().enumerate() {
            let (dx, dy, dz) = (leaf.x[i] - qx, leaf.y[i] - qy, leaf.z[i] - qz);
            *sq_distance = dx * dx + dy * dy + dz * dz;
        }
        if is_own {
            sq_distances[lane] = f32::NAN;
        }
        let bound = self.candidates.bound(lane);
        let mut near = 0u32;
        for (i, &sq_distance) in sq_distances.iter().enumerate() {
            near |= u32::from(sq_distance <= bound) << i;
        }
        let new = std::iter::from_fn(|| {
            let i = near.trailing_zeros() as usize;
            near &= near.wrapping_sub(1);
            (i < LEAF).then(|| key(sq_distances[i], leaf.index[i]))
        });
        self.candidates.extend(lane, new)
    }
}

/// Box around the queries of a block.
fn bounding_box(block: &Leaf) -> [[f32; 3]; 2] {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (axis, coordinates) in [&block.x, &block.y, &block.z].into_iter().enumerate() {
        for &c in &coordinates[..block.len] {
            lo[axis] = c.min(lo[axis]);
            hi[axis] = c.max(hi[axis]);
        }
    }
    [lo, hi]
}

/// How far something lies outside an interval, given how far it is beyond each end; 0 inside, and for NaN.
fn outside(above: f32, below: f32) -> f32 {
    let gap = if above > below { above } else { below };
    if gap > 0.0 { gap } else { 0.0 }
}
