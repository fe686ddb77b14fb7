//! Rows of the result, written block by block from several threads, each to its place in the order of the input.
#![allow(unsafe_code, reason = "rows of one vector that no two blocks share: slices cannot express it")]

use crate::Neighbors;
use crate::parallel;
use crate::tree::{LEAF, Leaf, Tree};

/// Blocks in a task: some 0.3 ms.
const BLOCKS: usize = 16;

/// Rows that are fetched before they are written. Where the input is in no spatial order the rows of a block are
/// scattered over the result, and stores that miss every cache would hold up the next search.
const AHEAD: usize = 8;

/// What is needed to write the rows of one block.
pub(crate) struct Rows<'a> {
    places: &'a [u32],
    k: usize,
    indices: *mut u32,
    sq_distances: *mut f32,
}

/// `search(state, block, rows)` for every block of `queries`; it has to write all rows of the block.
///
/// # Panics
/// If two lanes of the tree are the same query.
pub(crate) fn for_each_block<S>(
    queries: &Tree,
    k: usize,
    state: impl Fn() -> S + Send + Sync,
    search: impl Fn(&mut S, usize, &mut Rows) + Send + Sync,
) -> Neighbors {
    struct Shared(*mut u32, *mut f32);
    // SAFETY: the pointers are only used for rows of one block at a time, see below.
    unsafe impl Sync for Shared {}

    let rows = queries.n_points;
    assert_each_once(&queries.leaves, rows);
    let (mut indices, mut sq_distances) = (vec![0u32; rows * k], vec![0f32; rows * k]);
    let shared = Shared(indices.as_mut_ptr(), sq_distances.as_mut_ptr());
    let shared = &shared;
    parallel::for_each(queries.leaves.len(), BLOCKS, state, |state, block| {
        let places = &queries.leaves[block].index[..queries.len_of(block)];
        let mut rows = Rows { places, k, indices: shared.0, sq_distances: shared.1 };
        for lane in 0..AHEAD {
            rows.fetch(lane);
        }
        search(state, block, &mut rows);
    });
    Neighbors { rows, k, indices, sq_distances }
}

fn assert_each_once(leaves: &[Leaf], rows: usize) {
    let mut seen = vec![0u64; rows.div_ceil(64)];
    let mut left = rows;
    for leaf in leaves {
        for &row in &leaf.index[..left.min(LEAF)] {
            let (word, bit) = (&mut seen[row as usize / 64], 1 << (row % 64));
            assert!((row as usize) < rows && *word & bit == 0, "row {row} of {rows} appears twice");
            *word |= bit;
        }
        left = left.saturating_sub(LEAF);
    }
}

impl Rows<'_> {
    /// Calls `write(lane, indices, sq_distances)` for every lane of the block.
    pub(crate) fn write(&mut self, mut write: impl FnMut(usize, &mut [u32], &mut [f32])) {
        for (lane, &place) in self.places.iter().enumerate() {
            self.fetch(lane + AHEAD);
            let start = place as usize * self.k;
            // SAFETY: `places` are below the number of rows and in no other block, so that these k elements lie in
            // the vectors and nobody else has them while this exclusive borrow lasts.
            let (indices, sq_distances) = unsafe {
                (
                    std::slice::from_raw_parts_mut(self.indices.add(start), self.k),
                    std::slice::from_raw_parts_mut(self.sq_distances.add(start), self.k),
                )
            };
            write(lane, indices, sq_distances);
        }
    }

    /// Brings both ends of a lane's row into the cache; a hint, which changes nothing.
    fn fetch(&self, lane: usize) {
        #[cfg(target_arch = "x86_64")]
        if let Some(&place) = self.places.get(lane) {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let (first, last) = (place as usize * self.k, (place as usize + 1) * self.k - 1);
            for element in [first, last] {
                // SAFETY: the element is in the vector, as above; prefetching reads nothing.
                unsafe {
                    _mm_prefetch::<_MM_HINT_T0>(self.indices.add(element).cast());
                    _mm_prefetch::<_MM_HINT_T0>(self.sq_distances.add(element).cast());
                }
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = lane;
    }
}
