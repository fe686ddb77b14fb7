//! Twin of the pass `tile_ranges`: where each tile's run begins and ends in the sorted pairs.

use gs_shaders::{Frame, N_COUNTERS, N_PAIRS};

/// First pair and the one after the last of each tile, `[tiles]`, given the sorted tiles of the pairs; zeros where a tile has
/// none.
#[must_use]
pub fn tile_ranges(frame: &Frame, counters: &[u32; N_COUNTERS], pair_tiles: &[u32]) -> Vec<[u32; 2]> {
    let n_pairs = counters[N_PAIRS as usize].min(frame.pair_capacity) as usize;
    let pair_tiles = &pair_tiles[..n_pairs];
    (0..frame.tiles[0] * frame.tiles[1])
        .map(|tile| {
            let first = pair_tiles.partition_point(|&other| other < tile) as u32;
            let end = pair_tiles.partition_point(|&other| other <= tile) as u32;
            if first < end { [first, end] } else { [0, 0] }
        })
        .collect()
}
