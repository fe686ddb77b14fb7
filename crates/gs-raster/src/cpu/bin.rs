//! Lists of the Gaussians that touch each tile.

use super::project::Splat;
use super::{Grid, TILE};
use crate::{Error, Result};
use multiversion::multiversion;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Gaussians per task.
const CHUNK: usize = 16384;
/// The most pairs of Gaussian and tile that are listed: 1 GiB of indices.
const INTERSECTIONS_MAX: u64 = 1 << 28;

/// Per tile, the splats whose footprint may touch one of its pixel centres.
pub(super) struct Bins {
    chunks: Vec<Lists>,
    intersections: u64,
}

/// The lists of a run of neighbouring splats.
struct Lists {
    /// Where the list of each tile ends in `splats`; it starts where that of the tile before ends.
    ends: Vec<u32>,
    splats: Vec<u32>,
}

impl Bins {
    /// Lists `splats`.
    pub(super) fn new(splats: &[Splat], grid: Grid) -> Result<Self> {
        let found = AtomicU64::new(0);
        let chunks = splats
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(chunk, splats)| list(splats, (chunk * CHUNK) as u32, grid, &found))
            .collect();
        let intersections = found.into_inner();
        if intersections > INTERSECTIONS_MAX {
            return Err(Error::TooManyIntersections { found: intersections, limit: INTERSECTIONS_MAX });
        }
        Ok(Self { chunks, intersections })
    }

    /// Puts the splats of one tile into `list`, near to far; equal depths keep the order of the scene.
    pub(super) fn near_to_far(&self, tile: usize, splats: &[Splat], list: &mut Vec<u64>) {
        list.clear();
        for lists in &self.chunks {
            let start = if tile == 0 { 0 } else { lists.ends[tile - 1] };
            // Depths are positive, so their bits order as the numbers do.
            let key =
                |&index: &u32| u64::from(splats[index as usize].depth.to_bits()) << 32 | u64::from(index);
            list.extend(lists.splats[start as usize..lists.ends[tile] as usize].iter().map(key));
        }
        list.sort_unstable();
    }

    /// Pairs of splat and tile.
    pub(super) fn intersections(&self) -> u64 {
        self.intersections
    }
}

/// The lists of `splats`, the first of which has index `first`. What it finds is added to `found`; once that is beyond the
/// limit the lists are of no use, and it only counts.
fn list(splats: &[Splat], first: u32, grid: Grid, found: &AtomicU64) -> Lists {
    let mut spans = Vec::with_capacity(splats.len() * 2);
    let mut span_ends = Vec::with_capacity(splats.len());
    let mut count = 0;
    for splat in splats {
        count += push_spans(splat, grid, &mut spans);
        span_ends.push(spans.len());
    }
    if found.fetch_add(count, Ordering::Relaxed) + count > INTERSECTIONS_MAX {
        return Lists { ends: Vec::new(), splats: Vec::new() };
    }
    let mut slots = vec![0; grid.columns * grid.rows];
    for span in &spans {
        for slot in &mut slots[span.start as usize..span.end as usize] {
            *slot += 1;
        }
    }
    let mut offset = 0;
    for slot in &mut slots {
        (*slot, offset) = (offset, offset + *slot);
    }
    let mut lists = vec![0; count as usize];
    let mut start = 0;
    for (index, &end) in (first..).zip(&span_ends) {
        for span in &spans[start..end] {
            for slot in &mut slots[span.start as usize..span.end as usize] {
                lists[*slot as usize] = index;
                *slot += 1;
            }
        }
        start = end;
    }
    Lists { ends: slots, splats: lists }
}

/// Neighbouring tiles in one row.
struct Span {
    start: u32,
    end: u32,
}

/// Appends the tiles in which a pixel centre may lie inside the splat's ellipse, and returns their number.
///
/// Within a row of tiles the ellipse reaches farthest right at dy = `lean` if that is in the row, else at the edge
/// nearest to it; farthest left likewise at dy = -`lean`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn push_spans(splat: &Splat, grid: Grid, spans: &mut Vec<Span>) -> u64 {
    let [extent_x, extent_y] = splat.extent;
    let [x, y] = splat.mean;
    let Some((first, last)) = pixels(y, -extent_y, extent_y, grid.height) else { return 0 };
    let lean = splat.shear * extent_y * (extent_y / extent_x);
    let mut count = 0;
    for row in first / TILE..=last / TILE {
        let top = ((row * TILE) as f64 + 0.5 - y) as f32;
        let (low, high) = (top.max(-extent_y), (top + (TILE - 1) as f32).min(extent_y));
        let reach = |dy: f32| {
            let relative = dy / extent_y;
            (splat.shear * dy, splat.half_width * (1.0 - relative * relative).max(0.0).sqrt())
        };
        let (middle_left, half_left) = reach((-lean).max(low).min(high));
        let (middle_right, half_right) = reach(lean.max(low).min(high));
        let Some((left, right)) = pixels(x, middle_left - half_left, middle_right + half_right, grid.width)
        else {
            continue;
        };
        let (start, end) = (row * grid.columns + left / TILE, row * grid.columns + right / TILE + 1);
        spans.push(Span { start: start as u32, end: end as u32 });
        count += (end - start) as u64;
    }
    count
}

/// First and last pixel of `0..size` whose centre lies between `middle + low` and `middle + high`.
#[inline(always)]
fn pixels(middle: f64, low: f32, high: f32, size: usize) -> Option<(usize, usize)> {
    let first = (middle + f64::from(low) - 0.5).ceil().max(0.0);
    let last = (middle + f64::from(high) - 0.5).floor().min((size - 1) as f64);
    // In the range of i32: casts to it are single instructions.
    (first <= last).then_some((first as i32 as usize, last as i32 as usize))
}
