//! Lists of the Gaussians that touch each tile, near to far.

use super::project::Splat;
use super::{Grid, TILE};
use crate::{Error, Result};
use rayon::prelude::*;

/// Gaussians per task.
const CHUNK: usize = 16384;
/// The most pairs of Gaussian and tile that are listed: 1 GiB of indices.
const INTERSECTIONS_MAX: u64 = 1 << 28;

/// Per tile, the splats whose footprint touches one of its pixel centres, near to far.
pub(super) struct Bins {
    chunks: Vec<Lists>,
}

/// The lists of a run of splats that are neighbours in depth order.
struct Lists {
    /// Where the list of each tile ends in `splats`; it starts where that of the tile before ends.
    ends: Vec<u32>,
    splats: Vec<u32>,
}

impl Bins {
    /// Lists `splats`, which `order` sorts near to far.
    pub(super) fn new(splats: &[Splat], order: &[u32], grid: Grid) -> Result<Self> {
        let tiles = grid.columns * grid.rows;
        let counts: Vec<Vec<u32>> = order
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut counts = vec![0; tiles];
                for &index in chunk {
                    for_each_tile(&splats[index as usize], grid, |tile| counts[tile] += 1);
                }
                counts
            })
            .collect();
        let found = counts.iter().flatten().map(|&count| u64::from(count)).sum();
        if found > INTERSECTIONS_MAX {
            return Err(Error::TooManyIntersections { found, limit: INTERSECTIONS_MAX });
        }
        let chunks = order
            .par_chunks(CHUNK)
            .zip(counts)
            .map(|(chunk, mut slots)| {
                let mut offset = 0;
                for slot in &mut slots {
                    (*slot, offset) = (offset, offset + *slot);
                }
                let mut lists = vec![0; offset as usize];
                for &index in chunk {
                    for_each_tile(&splats[index as usize], grid, |tile| {
                        lists[slots[tile] as usize] = index;
                        slots[tile] += 1;
                    });
                }
                Lists { ends: slots, splats: lists }
            })
            .collect();
        Ok(Self { chunks })
    }

    /// The splats of one tile, near to far.
    pub(super) fn tile(&self, tile: usize) -> impl Iterator<Item = u32> {
        self.chunks.iter().flat_map(move |lists| {
            let start = if tile == 0 { 0 } else { lists.ends[tile - 1] };
            lists.splats[start as usize..lists.ends[tile] as usize].iter().copied()
        })
    }

    /// Pairs of splat and tile.
    pub(super) fn intersections(&self) -> u64 {
        self.chunks.iter().map(|lists| lists.splats.len() as u64).sum()
    }
}

/// Calls `visit` for every tile in which a pixel centre may lie inside the splat's ellipse.
///
/// Within a row of tiles the ellipse reaches farthest right at dy = `lean` if that is in the row, else at the edge
/// nearest to it; farthest left likewise at dy = -`lean`.
fn for_each_tile(splat: &Splat, grid: Grid, mut visit: impl FnMut(usize)) {
    let [extent_x, extent_y] = splat.extent;
    let [x, y] = splat.mean;
    let Some((first, last)) = pixels(y, -extent_y, extent_y, grid.height) else { return };
    let lean = splat.shear * extent_y * (extent_y / extent_x);
    for row in first / TILE..=last / TILE {
        let top = ((row * TILE) as f64 + 0.5 - y) as f32;
        let (low, high) = (top.max(-extent_y), (top + (TILE - 1) as f32).min(extent_y));
        let reach = |dy: f32| {
            let relative = dy / extent_y;
            (splat.shear * dy, splat.half_width * (1.0 - relative * relative).max(0.0).sqrt())
        };
        let (middle_left, half_left) = reach((-lean).max(low).min(high));
        let (middle_right, half_right) = reach(lean.max(low).min(high));
        let span = pixels(x, middle_left - half_left, middle_right + half_right, grid.width);
        let Some((left, right)) = span else { continue };
        for column in left / TILE..=right / TILE {
            visit(row * grid.columns + column);
        }
    }
}

/// First and last pixel of `0..size` whose centre lies between `middle + low` and `middle + high`.
fn pixels(middle: f64, low: f32, high: f32, size: usize) -> Option<(usize, usize)> {
    let first = (middle + f64::from(low) - 0.5).ceil().max(0.0);
    let last = (middle + f64::from(high) - 0.5).floor().min((size - 1) as f64);
    (first <= last).then_some((first as usize, last as usize))
}
