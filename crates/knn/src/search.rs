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
    let mut keys = vec![NO_CANDIDATE; n_queries * k];
    keys.par_chunks_mut(LEAF * k).zip(&queries.leaves).enumerate().for_each(|(leaf_idx, (rows, block))| {
        let own = exclude_self.then_some(leaf_idx);
        Search::new(points, block, rows, k).run(own);
    });
    keys
}

struct Search<'a> {
    points: &'a Tree,
    block: &'a Leaf,
    /// Box of the block.
    around: [[f32; 3]; 2],
    k: usize,
    /// Sorted keys found so far, `[block.len, k]`.
    rows: &'a mut [u64],
    /// Squared distance of each query's last candidate.
    bounds: [f32; LEAF],
}

impl<'a> Search<'a> {
    fn new(points: &'a Tree, block: &'a Leaf, rows: &'a mut [u64], k: usize) -> Self {
        Self { points, block, around: bounding_box(block), k, rows, bounds: [f32::INFINITY; LEAF] }
    }

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
                    last = self.last();
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
        let gap = |axis: usize| {
            let above = node.lo[axis] - hi[axis];
            let below = lo[axis] - node.hi[axis];
            positive(if above > below { above } else { below })
        };
        let (dx, dy, dz) = (gap(0), gap(1), gap(2));
        key(dx * dx + dy * dy + dz * dz, node.min_index)
    }

    /// Largest key that is still a neighbour of some query of the block.
    fn last(&self) -> u64 {
        self.rows.chunks_exact(self.k).map(|row| row[self.k - 1]).max().unwrap_or(0)
    }

    /// Offers the points of a leaf to every query of the block that they can matter to; says whether any entered.
    fn visit(&mut self, node: usize, leaf_idx: usize, is_own: bool) -> bool {
        let Node { lo, hi, .. } = self.points.nodes[node];
        let block = self.block;
        let mut to_box = [0f32; LEAF];
        for (lane, to_box) in to_box.iter_mut().enumerate() {
            let gap = |q: f32, axis: usize| {
                let (above, below) = (lo[axis] - q, q - hi[axis]);
                positive(if above > below { above } else { below })
            };
            let (dx, dy, dz) = (gap(block.x[lane], 0), gap(block.y[lane], 1), gap(block.z[lane], 2));
            *to_box = dx * dx + dy * dy + dz * dz;
        }
        let mut changed = false;
        for (lane, &to_box) in to_box.iter().enumerate().take(block.len) {
            if to_box <= self.bounds[lane] {
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
        let bound = self.bounds[lane];
        let mut near = 0u32;
        for (i, &sq_distance) in sq_distances.iter().enumerate() {
            near |= u32::from(sq_distance <= bound) << i;
        }
        let row = &mut self.rows[lane * self.k..][..self.k];
        let mut changed = false;
        while near != 0 {
            let i = near.trailing_zeros() as usize;
            near &= near - 1;
            changed |= insert(row, key(sq_distances[i], leaf.index[i]));
        }
        self.bounds[lane] = split_key(row[self.k - 1]).0;
        changed
    }
}

/// Keeps the smallest keys, sorted.
fn insert(row: &mut [u64], key: u64) -> bool {
    let mut i = row.len() - 1;
    if key >= row[i] {
        return false;
    }
    while i > 0 && row[i - 1] > key {
        row[i] = row[i - 1];
        i -= 1;
    }
    row[i] = key;
    true
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

fn positive(c: f32) -> f32 {
    if c > 0.0 { c } else { 0.0 }
}
