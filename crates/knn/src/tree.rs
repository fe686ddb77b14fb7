//! A balanced k-d tree whose leaves are blocks of [`LEAF`] points with tight bounding boxes. Median splits on the
//! widest axis keep it balanced on any set: equal points, lattices, lines, mixed scales. Equal coordinates are
//! split by index, so that among equal points the lowest indices share a leaf.

use crate::parallel;
use crate::search::key;

/// Points per leaf, at most the 32 bits of a mask. All are full but the last.
pub(crate) const LEAF: usize = 32;

/// Subtrees of at most this many points are built on one thread.
const SEQUENTIAL: usize = 4096;

/// The points of a leaf by coordinate. Lanes without a point hold NaN, which compares false with every bound.
#[derive(Clone)]
#[repr(C, align(64))]
pub(crate) struct Leaf {
    pub(crate) x: [f32; LEAF],
    pub(crate) y: [f32; LEAF],
    pub(crate) z: [f32; LEAF],
    pub(crate) index: [u32; LEAF],
}

/// Tight bounding box and lowest index of some points.
#[derive(Clone, Copy)]
pub(crate) struct Bounds {
    pub(crate) lo: [f32; 3],
    pub(crate) hi: [f32; 3],
    pub(crate) min_index: u32,
}

/// A set of points that is searched: built once, and queried as often as one likes. The answers are those of [`knn`](crate::knn()) and
/// [`query`](crate::query), bit for bit.
///
/// It takes 18 bytes per point, 34 while it is built.
// Nodes in preorder. A node over `c > 1` leaves has its left child, over `c / 2` of them, right behind it, and its
// right child behind the `2 (c / 2) - 1` nodes of the left one.
pub struct Tree {
    pub(crate) nodes: Vec<Bounds>,
    pub(crate) leaves: Vec<Leaf>,
    pub(crate) n_points: usize,
}

#[derive(Clone, Copy)]
struct Item {
    position: [f32; 3],
    index: u32,
}

impl Tree {
    /// A tree of points that are all finite.
    pub(crate) fn build(points: &[[f32; 3]]) -> Self {
        let mut items: Vec<Item> =
            (0u32..).zip(points).map(|(index, &position)| Item { position, index }).collect();
        let n_leaves = points.len().div_ceil(LEAF);
        let mut nodes = vec![Bounds::EMPTY; (2 * n_leaves).saturating_sub(1)];
        if !items.is_empty() {
            split(&mut items, &mut nodes);
        }
        let leaves = items.chunks(LEAF).map(Leaf::new).collect();
        Self { nodes, leaves, n_points: points.len() }
    }

    /// Points in a leaf.
    pub(crate) fn len_of(&self, leaf: usize) -> usize {
        LEAF.min(self.n_points - leaf * LEAF)
    }
}

impl Leaf {
    pub(crate) const EMPTY: Self =
        Self { x: [f32::NAN; LEAF], y: [f32::NAN; LEAF], z: [f32::NAN; LEAF], index: [u32::MAX; LEAF] };

    fn new(items: &[Item]) -> Self {
        let mut leaf = Self::EMPTY;
        for (lane, item) in items.iter().enumerate() {
            [leaf.x[lane], leaf.y[lane], leaf.z[lane]] = item.position;
            leaf.index[lane] = item.index;
        }
        leaf
    }
}

impl Bounds {
    const EMPTY: Self = Self { lo: [f32::INFINITY; 3], hi: [f32::NEG_INFINITY; 3], min_index: u32::MAX };

    fn of_items(items: &[Item]) -> Self {
        let mut bounds = Self::EMPTY;
        for item in items {
            for (axis, &c) in item.position.iter().enumerate() {
                bounds.widen(axis, c);
            }
            bounds.min_index = bounds.min_index.min(item.index);
        }
        bounds
    }

    /// Of the first `len` points.
    pub(crate) fn of_leaf(leaf: &Leaf, len: usize) -> Self {
        let mut bounds = Self::EMPTY;
        for (axis, coordinates) in [&leaf.x, &leaf.y, &leaf.z].into_iter().enumerate() {
            for &c in &coordinates[..len] {
                bounds.widen(axis, c);
            }
        }
        bounds
    }

    fn widen(&mut self, axis: usize, c: f32) {
        self.lo[axis] = if c < self.lo[axis] { c } else { self.lo[axis] };
        self.hi[axis] = if c > self.hi[axis] { c } else { self.hi[axis] };
    }

    /// A key that none of `others` can undercut for any query in this box.
    ///
    /// Safe in f32: rounding is monotone, so for `q <= hi < lo <= p` the rounded `lo - hi` is at most the rounded
    /// `p - q`, and the same holds for squares and sums taken in the order of the true distance.
    pub(crate) fn lowest_key(&self, others: &Self) -> u64 {
        let gap = |axis: usize| outside(others.lo[axis] - self.hi[axis], self.lo[axis] - others.hi[axis]);
        let (dx, dy, dz) = (gap(0), gap(1), gap(2));
        key(dx * dx + dy * dy + dz * dz, others.min_index)
    }

    /// As `lowest_key`, for these points and one query.
    pub(crate) fn lowest_key_of(&self, query: [f32; 3]) -> u64 {
        let gap = |axis: usize| outside(self.lo[axis] - query[axis], query[axis] - self.hi[axis]);
        let (dx, dy, dz) = (gap(0), gap(1), gap(2));
        key(dx * dx + dy * dy + dz * dz, self.min_index)
    }

    fn extent(&self, axis: usize) -> f32 {
        self.hi[axis] - self.lo[axis]
    }

    fn widest_axis(&self) -> usize {
        let wider = |a, b| if self.extent(b) > self.extent(a) { b } else { a };
        wider(wider(0, 1), 2)
    }
}

/// Orders `items` leaf by leaf and fills the preorder `nodes` of their subtree.
fn split(items: &mut [Item], nodes: &mut [Bounds]) {
    let bounds = Bounds::of_items(items);
    nodes[0] = bounds;
    let n_leaves = nodes.len().div_ceil(2);
    if n_leaves == 1 {
        return;
    }
    let axis = bounds.widest_axis();
    let left_leaves = n_leaves / 2;
    let middle = left_leaves * LEAF;
    if bounds.extent(axis) * bounds.extent(axis) == 0.0 {
        // Every distance in here underflows to zero, so that indices alone decide.
        items.select_nth_unstable_by_key(middle, |item| item.index);
    } else {
        items.select_nth_unstable_by_key(middle, |item| {
            u64::from(ordered(item.position[axis])) << 32 | u64::from(item.index)
        });
    }
    let sequential = items.len() <= SEQUENTIAL;
    let (left_items, right_items) = items.split_at_mut(middle);
    let (left_nodes, right_nodes) = nodes[1..].split_at_mut(2 * left_leaves - 1);
    if sequential {
        split(left_items, left_nodes);
        split(right_items, right_nodes);
    } else {
        parallel::join(|| split(left_items, left_nodes), || split(right_items, right_nodes));
    }
}

/// Bits that order as the finite numbers do.
fn ordered(c: f32) -> u32 {
    let bits = c.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

/// How far something lies outside an interval, given how far it is beyond each end; 0 inside, and for NaN.
fn outside(above: f32, below: f32) -> f32 {
    let gap = if above > below { above } else { below };
    if gap > 0.0 { gap } else { 0.0 }
}
