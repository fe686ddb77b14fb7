//! Lists of the splats that touch each tile, near to far.

use super::project::{Splat, Splats};
use super::{Grid, TILE};
use crate::settings::INTERSECTIONS_MAX;
use crate::{Error, Result};
use multiversion::multiversion;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Splats per task, at least. In large pictures it is one per tile, so that what is kept per chunk and tile takes no more
/// memory than the splats do.
const CHUNK: usize = 4096;

/// Per tile, the splats whose footprint may touch one of its pixel centres.
#[derive(Debug, Default)]
pub(super) struct Bins {
    chunks: Vec<Lists>,
    /// How many of `chunks` are in use.
    used: usize,
    intersections: u64,
}

/// The lists of a run of splats that follow each other in depth.
#[derive(Debug, Default)]
struct Lists {
    /// Where the list of each tile ends in `splats`; it starts where that of the tile before ends.
    ends: Vec<u32>,
    splats: Vec<u32>,
    /// Tiles by splat.
    spans: Vec<Span>,
    /// How many spans each splat has.
    counts: Vec<u32>,
}

/// Splats per task.
pub(super) fn chunk_size(grid: Grid) -> usize {
    CHUNK.max(grid.tiles())
}

impl Bins {
    /// Lists the splats of `order`, indices near to far; what was here is forgotten.
    pub(super) fn list(&mut self, splats: &Splats, order: &[u32], grid: Grid) -> Result<()> {
        let found = AtomicU64::new(0);
        self.used = order.len().div_ceil(chunk_size(grid));
        if self.chunks.len() < self.used {
            self.chunks.resize_with(self.used, Lists::default);
        }
        self.chunks
            .par_iter_mut()
            .zip(order.par_chunks(chunk_size(grid)))
            .for_each(|(lists, order)| lists.list(splats, order, grid, &found));
        self.intersections = found.into_inner();
        if self.intersections > INTERSECTIONS_MAX {
            return Err(Error::TooManyIntersections { found: self.intersections, limit: INTERSECTIONS_MAX });
        }
        Ok(())
    }

    /// The splats of one tile, near to far, in pieces.
    pub(super) fn pieces(&self, tile: usize) -> impl DoubleEndedIterator<Item = &[u32]> {
        self.chunks[..self.used].iter().map(move |lists| lists.of(tile))
    }

    /// Length of the list of one tile.
    pub(super) fn len(&self, tile: usize) -> usize {
        self.pieces(tile).map(<[u32]>::len).sum()
    }

    /// Pairs of splat and tile.
    pub(super) fn intersections(&self) -> u64 {
        self.intersections
    }

    /// The splats of each chunk and where they stand in the lists of their tiles.
    pub(super) fn places(&self) -> Vec<Places<'_>> {
        let tiles = self.chunks.first().map_or(0, |lists| lists.ends.len());
        let mut cursors = vec![0; tiles];
        let mut places = Vec::with_capacity(self.used);
        for lists in &self.chunks[..self.used] {
            places.push(Places { lists, cursors: cursors.clone() });
            for (tile, cursor) in cursors.iter_mut().enumerate() {
                *cursor += lists.of(tile).len() as u32;
            }
        }
        places
    }
}

/// Where the splats of a chunk stand in the lists of their tiles.
pub(super) struct Places<'a> {
    lists: &'a Lists,
    /// Per tile, the length of its list before this chunk.
    cursors: Vec<u32>,
}

impl Places<'_> {
    /// Number of splats.
    pub(super) fn len(&self) -> usize {
        self.lists.counts.len()
    }

    /// Calls `visit` for each splat of the chunk, in the order of depth, with its tiles and its place in each.
    pub(super) fn for_each(mut self, mut visit: impl FnMut(&[(usize, usize)])) {
        let mut spans = self.lists.spans.iter();
        let mut places = Vec::new();
        for &count in &self.lists.counts {
            places.clear();
            for span in spans.by_ref().take(count as usize) {
                for tile in span.start as usize..span.end as usize {
                    places.push((tile, self.cursors[tile] as usize));
                    self.cursors[tile] += 1;
                }
            }
            visit(&places);
        }
    }
}

impl Lists {
    fn of(&self, tile: usize) -> &[u32] {
        let start = if tile == 0 { 0 } else { self.ends[tile - 1] };
        &self.splats[start as usize..self.ends[tile] as usize]
    }

    /// Lists the splats with indices `order`. What it finds is added to `found`; once that is beyond the limit the lists
    /// are of no use, and it only counts.
    fn list(&mut self, splats: &Splats, order: &[u32], grid: Grid, found: &AtomicU64) {
        let Self { ends, splats: lists, spans, counts } = self;
        spans.clear();
        counts.clear();
        let count = find_spans(splats, order, grid, spans, counts);
        ends.clear();
        ends.resize(grid.tiles(), 0);
        lists.clear();
        if found.fetch_add(count, Ordering::Relaxed) + count > INTERSECTIONS_MAX {
            return;
        }
        for span in &*spans {
            for end in &mut ends[span.start as usize..span.end as usize] {
                *end += 1;
            }
        }
        let mut offset = 0;
        for end in &mut *ends {
            (*end, offset) = (offset, offset + *end);
        }
        lists.resize(count as usize, 0);
        let mut rest = spans.iter();
        for (&index, &count) in order.iter().zip(&*counts) {
            for span in rest.by_ref().take(count as usize) {
                for end in &mut ends[span.start as usize..span.end as usize] {
                    lists[*end as usize] = index;
                    *end += 1;
                }
            }
        }
    }
}

/// Neighbouring tiles in one row.
#[derive(Debug)]
struct Span {
    start: u32,
    end: u32,
}

/// Appends the tiles in which a pixel centre may lie inside the ellipses of the splats, and the number of spans of each
/// splat. Returns the number of tiles.
#[multiversion(targets("x86_64+avx2+fma"))]
fn find_spans(
    splats: &Splats,
    order: &[u32],
    grid: Grid,
    spans: &mut Vec<Span>,
    counts: &mut Vec<u32>,
) -> u64 {
    let mut tiles = 0;
    for &index in order {
        let before = spans.len();
        tiles += push_spans(splats.get(index), grid, spans);
        counts.push((spans.len() - before) as u32);
    }
    tiles
}

/// Within a row of tiles the ellipse reaches farthest right at dy = `lean` if that is in the row, else at the edge
/// nearest to it; farthest left likewise at dy = -`lean`.
#[inline(always)]
fn push_spans(splat: &Splat, grid: Grid, spans: &mut Vec<Span>) -> u64 {
    let [extent_x, extent_y] = splat.extent;
    let [x, y] = splat.mean;
    let Some((top, bottom)) = pixels(y, -extent_y, extent_y, grid.height) else { return 0 };
    let Some((left, right)) = pixels(x, -extent_x, extent_x, grid.width) else { return 0 };
    let (rows, columns) = (top / TILE..bottom / TILE + 1, left / TILE..right / TILE + 1);
    let mut count = 0;
    let mut push = |row: usize, left: usize, right: usize| {
        let (start, end) = (row * grid.columns + left / TILE, row * grid.columns + right / TILE + 1);
        spans.push(Span { start: start as u32, end: end as u32 });
        count += (end - start) as u64;
    };
    // In one row or column of tiles the ellipse touches all that its bounding box does.
    if rows.len() == 1 || columns.len() == 1 {
        for row in rows {
            push(row, left, right);
        }
        return count;
    }
    let lean = splat.shear * extent_y * (extent_y / extent_x);
    for row in rows {
        let top = ((row * TILE) as f64 + 0.5 - y) as f32;
        let (low, high) = (top.max(-extent_y), (top + (TILE - 1) as f32).min(extent_y));
        let reach = |dy: f32| {
            let relative = dy / extent_y;
            (splat.shear * dy, splat.half_width * (1.0 - relative * relative).max(0.0).sqrt())
        };
        let (middle_left, half_left) = reach((-lean).max(low).min(high));
        let (middle_right, half_right) = reach(lean.max(low).min(high));
        if let Some((left, right)) = pixels(x, middle_left - half_left, middle_right + half_right, grid.width)
        {
            push(row, left, right);
        }
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
