//! All queries of a leaf are searched together: one walk through the tree serves [`LEAF`](crate::tree::LEAF) of them.

use crate::Neighbors;
use crate::candidates::Candidates;
use crate::scatter;
use crate::tree::{Bounds, Leaf, Tree};

/// A candidate as one integer: the bits of its squared distance above its index. Squared distances are at least
/// +0, and such floats order as their bits do, so that keys order by distance, then index, infinity included.
pub(crate) fn key(sq_distance: f32, index: u32) -> u64 {
    u64::from(sq_distance.to_bits()) << 32 | u64::from(index)
}

/// Squared distance and index of a key.
pub(crate) fn split_key(key: u64) -> (f32, u32) {
    (f32::from_bits((key >> 32) as u32), key as u32)
}

/// Above every key of a point, below every NaN.
pub(crate) const NO_CANDIDATE: u64 = (f32::INFINITY.to_bits() as u64) << 32 | u32::MAX as u64;

/// The nearest points so far of each query of a block.
pub(crate) trait Lists {
    /// Starts with another block of queries, the first `len` lanes of it.
    fn begin(&mut self, block: &Leaf, len: usize);
    /// Offers the block to itself: to each query all points but that with its own index.
    fn offer_own(&mut self);
    /// Offers the points of a leaf to every query that has its box within reach; says whether `last` may have changed.
    fn offer(&mut self, leaf: &Leaf, bounds: &Bounds) -> bool;
    /// No point with a higher key is among the `k` nearest of any query.
    fn last(&self) -> u64;
    /// The `k` nearest of a query, sorted.
    fn finish(&mut self, lane: usize, indices: &mut [u32], sq_distances: &mut [f32]);
}

/// Which points a query finds.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Among {
    All,
    /// All but that with its own index; both trees are the same.
    Others,
}

/// The `k` nearest points of every query, in the order of the input. There must be that many.
pub(crate) fn search(points: &Tree, queries: &Tree, k: usize, among: Among) -> Neighbors {
    #[cfg(target_arch = "x86_64")]
    if crate::avx2::Avx2Lists::serves(k) {
        return search_with(points, queries, k, among, || crate::avx2::Avx2Lists::new(k));
    }
    search_with(points, queries, k, among, || Candidates::new(k))
}

fn search_with<L: Lists>(
    points: &Tree,
    queries: &Tree,
    k: usize,
    among: Among,
    lists: impl Fn() -> L + Send + Sync,
) -> Neighbors {
    // The first points of the set are candidates of every query, at infinity in the worst case: distances that
    // overflow are pruned by index from the start.
    let worst = match among {
        Among::All => key(f32::INFINITY, k as u32 - 1),
        Among::Others => key(f32::INFINITY, k as u32),
    };
    let state = || (lists(), Vec::new());
    scatter::for_each_block(queries, k, state, |(lists, stack), block, rows| {
        let (leaf, len) = (&queries.leaves[block], queries.len_of(block));
        lists.begin(leaf, len);
        let own_leaf = (among == Among::Others).then_some(block);
        if own_leaf.is_some() {
            lists.offer_own();
        }
        walk(points, &Bounds::of_leaf(leaf, len), own_leaf, worst, lists, stack);
        rows.write(|lane, indices, sq_distances| lists.finish(lane, indices, sq_distances));
    })
}

/// A subtree that is still to be looked at.
struct Subtree {
    /// No point in it has a lower key for any query of the block.
    lowest: u64,
    node: usize,
    first_leaf: usize,
    n_leaves: usize,
}

/// Depth first, nearer child first. `own_leaf` is the leaf that the block itself is.
fn walk(
    points: &Tree,
    around: &Bounds,
    own_leaf: Option<usize>,
    worst: u64,
    lists: &mut impl Lists,
    stack: &mut Vec<Subtree>,
) {
    let subtree = |node: usize, first_leaf: usize, n_leaves: usize| Subtree {
        lowest: around.lowest_key(&points.nodes[node]),
        node,
        first_leaf,
        n_leaves,
    };
    let mut last = worst.min(lists.last());
    stack.push(subtree(0, 0, points.leaves.len()));
    while let Some(Subtree { lowest, node, first_leaf, n_leaves }) = stack.pop() {
        // Comparing keys covers ties: where distances are equal, only a lower index would enter. Without it, a set
        // of equal points would make every block visit every leaf.
        if lowest > last {
            continue;
        }
        if n_leaves == 1 {
            if own_leaf != Some(first_leaf) && lists.offer(&points.leaves[first_leaf], &points.nodes[node]) {
                last = worst.min(lists.last());
            }
            continue;
        }
        let left_leaves = n_leaves / 2;
        let left = subtree(node + 1, first_leaf, left_leaves);
        let right = subtree(node + 2 * left_leaves, first_leaf + left_leaves, n_leaves - left_leaves);
        let (near, far) = if right.lowest < left.lowest { (right, left) } else { (left, right) };
        stack.push(far);
        stack.push(near);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{brute_force, brute_force_query, sets};

    /// What does not depend on the processor is tested on all of them, not only where it is what is used.
    #[test]
    fn lists_of_any_processor_equal_brute_force() {
        for shape in sets::SHAPES {
            for (n, k) in [(2, 1), (33, 7), (700, 1), (700, 20), (700, 33), (700, 300)] {
                let (points, queries) = (sets::set(shape, n, 5), sets::set(shape, 90, 6));
                let (tree, asking) = (Tree::build(&points), Tree::build(&queries));
                let found = search_with(&tree, &tree, k, Among::Others, || Candidates::new(k));
                assert_eq!(Ok(found), brute_force(&points, k), "{shape}, {n} points, k = {k}");
                let found = search_with(&tree, &asking, k, Among::All, || Candidates::new(k));
                assert_eq!(
                    Ok(found),
                    brute_force_query(&points, &queries, k),
                    "{shape}, {n} points, k = {k}"
                );
            }
        }
    }
}
