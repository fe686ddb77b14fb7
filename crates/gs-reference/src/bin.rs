//! Twin of the pass `bin`: which Gaussians touch which tiles.

use crate::grid::{ellipse_of, tile_columns, tile_rows};
use gs_shaders::{Frame, N_COUNTERS, Splat, VISIBLE};

/// Pairs of Gaussian and tile, in the order of depth of the Gaussians.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Pairs {
    /// Tiles, `[pairs]`; the number of tiles where a Gaussian has fewer than it announced.
    pub tiles: Vec<u32>,
    /// Own index, `[pairs]`.
    pub index: Vec<u32>,
    /// Index of the Gaussian, `[pairs]`.
    pub splats: Vec<u32>,
}

/// How many tiles each Gaussian touches, in the order of depth, `[N + 1]`: 0 where there is none.
#[must_use]
pub fn bin_count(frame: &Frame, splats: &[Splat], order: &[u32], counters: &[u32; N_COUNTERS]) -> Vec<u32> {
    let visible = &order[..counters[VISIBLE as usize] as usize];
    let mut counts: Vec<u32> =
        visible.iter().map(|&index| tiles_of(frame, &splats[index as usize]).len() as u32).collect();
    counts.resize(frame.n_gaussians as usize + 1, 0);
    counts
}

/// The pairs for which there is room, given the place of each Gaussian's first one, `[N + 1]`.
#[must_use]
pub fn bin_emit(
    frame: &Frame,
    splats: &[Splat],
    order: &[u32],
    counters: &[u32; N_COUNTERS],
    offsets: &[u32],
) -> Pairs {
    let no_tile = frame.tiles[0] * frame.tiles[1];
    let mut pairs = Pairs::default();
    for rank in 0..counters[VISIBLE as usize] as usize {
        let index = order[rank];
        let mut tiles = tiles_of(frame, &splats[index as usize]).into_iter();
        let room = offsets[rank].min(frame.pair_capacity)..offsets[rank + 1].min(frame.pair_capacity);
        for pair in room {
            pairs.tiles.push(tiles.next().unwrap_or(no_tile));
            pairs.index.push(pair);
            pairs.splats.push(index);
        }
    }
    pairs
}

/// Tiles that a footprint touches, row by row.
fn tiles_of(frame: &Frame, splat: &Splat) -> Vec<u32> {
    let ellipse = ellipse_of(splat, f64::from(frame.alpha_min).log2());
    tile_rows(&ellipse, frame)
        .flat_map(|row| tile_columns(&ellipse, row, frame).map(move |column| row * frame.tiles[0] + column))
        .collect()
}
