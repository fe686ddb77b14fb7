//! A balanced k-d tree whose leaves are blocks of [`LEAF`] points with tight bounding boxes. Median splits on the
//! widest axis keep it balanced on any set: equal points, lattices, lines, mixed scales. Equal coordinates are
//! split by index, so that among equal points the lowest indices share a leaf.

/// Points per leaf, at most the 32 bits of a mask. Measured at K = 20: 32 takes 4 % less time than 16, and 16 takes 8 %
/// less than 8.
pub(crate) const LEAF: usize = 32;

/// Subtrees of at most this many points are built on one thread.
const SEQUENTIAL: usize = 4096;

/// The points of a leaf by coordinate. Lanes from `len` on hold NaN, which compares false with every bound.
pub(crate) struct Leaf {
    pub(crate) x: [f32; LEAF],
    pub(crate) y: [f32; LEAF],
    pub(crate) z: [f32; LEAF],
    pub(crate) index: [u32; LEAF],
    pub(crate) len: usize,
}

/// Tight bounding box and lowest index of the points below a node.
#[derive(Clone, Copy)]
pub(crate) struct Node {
    pub(crate) lo: [f32; 3],
    pub(crate) hi: [f32; 3],
    pub(crate) min_index: u32,
}

/// Nodes in preorder. A node over `c > 1` leaves has its left child, over `c / 2` of them, right behind it, and its
/// right child behind the `2 (c / 2) - 1` nodes of the left one.
pub(crate) struct Tree {
    pub(crate) nodes: Vec<Node>,
    pub(crate) leaves: Vec<Leaf>,
}

#[derive(Clone, Copy)]
struct Item {
    position: [f32; 3],
    index: u32,
}

impl Tree {
    /// A tree over at least one point, all finite.
    pub(crate) fn new(points: &[[f32; 3]]) -> Self {
        let mut items: Vec<Item> =
            (0u32..).zip(points).map(|(index, &position)| Item { position, index }).collect();
        let n_leaves = points.len().div_ceil(LEAF);
        let empty = Node { lo: [0.0; 3], hi: [0.0; 3], min_index: 0 };
        let mut nodes = vec![empty; 2 * n_leaves - 1];
        split(&mut items, &mut nodes);
        let leaves = items.chunks(LEAF).map(Leaf::new).collect();
        Self { nodes, leaves }
    }
}

impl Leaf {
    fn new(items: &[Item]) -> Self {
        let mut leaf = Self {
            x: [f32::NAN; LEAF],
            y: [f32::NAN; LEAF],
            z: [f32::NAN; LEAF],
            index: [u32::MAX; LEAF],
            len: items.len(),
        };
        for (lane, item) in items.iter().enumerate() {
            [leaf.x[lane], leaf.y[lane], leaf.z[lane]] = item.position;
            leaf.index[lane] = item.index;
        }
        leaf
    }
}

impl Node {
    fn around(items: &[Item]) -> Self {
        let mut node = Self { lo: [f32::INFINITY; 3], hi: [f32::NEG_INFINITY; 3], min_index: u32::MAX };
        for item in items {
            for (axis, &c) in item.position.iter().enumerate() {
                node.lo[axis] = if c < node.lo[axis] { c } else { node.lo[axis] };
                node.hi[axis] = if c > node.hi[axis] { c } else { node.hi[axis] };
            }
            node.min_index = node.min_index.min(item.index);
        }
        node
    }

    fn widest_axis(&self) -> usize {
        let extent = |axis: usize| self.hi[axis] - self.lo[axis];
        let wider = |a, b| if extent(b) > extent(a) { b } else { a };
        wider(wider(0, 1), 2)
    }
}

/// Orders `items` leaf by leaf and fills the preorder `nodes` of their subtree.
fn split(items: &mut [Item], nodes: &mut [Node]) {
    let node = Node::around(items);
    nodes[0] = node;
    let n_leaves = nodes.len().div_ceil(2);
    if n_leaves == 1 {
        return;
    }
    let axis = node.widest_axis();
    let left_leaves = n_leaves / 2;
    let middle = left_leaves * LEAF;
    items.select_nth_unstable_by_key(middle, |item| {
        u64::from(ordered(item.position[axis])) << 32 | u64::from(item.index)
    });
    let sequential = items.len() <= SEQUENTIAL;
    let (left_items, right_items) = items.split_at_mut(middle);
    let (left_nodes, right_nodes) = nodes[1..].split_at_mut(2 * left_leaves - 1);
    if sequential {
        split(left_items, left_nodes);
        split(right_items, right_nodes);
    } else {
        rayon::join(|| split(left_items, left_nodes), || split(right_items, right_nodes));
    }
}

/// Bits that order as the finite numbers do.
fn ordered(c: f32) -> u32 {
    let bits = c.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}
