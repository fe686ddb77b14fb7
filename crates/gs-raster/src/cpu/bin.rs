//! Lists of the splats that touch each tile, near to far.

use super::Grid;
use super::project::{BATCH, Splats};
use super::span::{Span, Tiles};
use rayon::prelude::*;

/// Splats per task, at least. In large pictures it is one per tile, so that what is kept per chunk and tile takes no more
/// memory than the splats do.
const CHUNK: usize = 4096;

/// Per tile, the splats whose footprint may touch one of its pixel centres.
#[derive(Debug, Default)]
pub(super) struct Bins {
    chunks: Vec<Lists>,
    /// How many of `chunks` are in use.
    used: usize,
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
    pub(super) fn list(&mut self, splats: &Splats, order: &[u32], grid: Grid) {
        self.used = order.len().div_ceil(chunk_size(grid));
        if self.chunks.len() < self.used {
            self.chunks.resize_with(self.used, Lists::default);
        }
        self.chunks
            .par_iter_mut()
            .zip(order.par_chunks(chunk_size(grid)))
            .for_each(|(lists, order)| lists.list(splats, order, grid));
    }

    /// The splats of one tile, near to far, in pieces.
    pub(super) fn pieces(&self, tile: usize) -> impl DoubleEndedIterator<Item = &[u32]> {
        self.chunks[..self.used].iter().map(move |lists| lists.of(tile))
    }

    /// Length of the list of one tile.
    pub(super) fn len(&self, tile: usize) -> usize {
        self.pieces(tile).map(<[u32]>::len).sum()
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

    /// Calls `visit` for the splats of the chunk, in the order of depth and [`BATCH`] at a time: with their tiles and the place in each, and with how
    /// many of these are of each splat.
    pub(super) fn for_each_batch(mut self, mut visit: impl FnMut(&[(usize, usize)], &[u32])) {
        let mut spans = self.lists.spans.iter();
        let mut places = Vec::new();
        let mut of_splat = [0; BATCH];
        for counts in self.lists.counts.chunks(BATCH) {
            places.clear();
            for (of_splat, &count) in of_splat.iter_mut().zip(counts) {
                let before = places.len();
                for span in spans.by_ref().take(count as usize) {
                    for tile in span.start as usize..span.end as usize {
                        places.push((tile, self.cursors[tile] as usize));
                        self.cursors[tile] += 1;
                    }
                }
                *of_splat = (places.len() - before) as u32;
            }
            visit(&places, &of_splat[..counts.len()]);
        }
    }
}

impl Lists {
    fn of(&self, tile: usize) -> &[u32] {
        let start = if tile == 0 { 0 } else { self.ends[tile - 1] };
        &self.splats[start as usize..self.ends[tile] as usize]
    }

    /// Lists the splats with indices `order`.
    fn list(&mut self, splats: &Splats, order: &[u32], grid: Grid) {
        let Self { ends, splats: lists, spans, counts } = self;
        spans.clear();
        counts.clear();
        let mut batch = [Tiles::NONE; BATCH];
        for indices in order.chunks(BATCH) {
            for (tiles, &index) in batch.iter_mut().zip(indices) {
                *tiles = splats.tiles(index);
            }
            for (&tiles, &index) in batch.iter().zip(indices) {
                match tiles {
                    Tiles::One(span) => {
                        spans.push(span);
                        counts.push(1);
                    }
                    Tiles::Several { first, count } => {
                        // Few: a call to copy them would cost more.
                        for &span in splats.spans(index, first, count) {
                            spans.push(span);
                        }
                        counts.push(count);
                    }
                }
            }
        }
        ends.clear();
        ends.resize(grid.tiles(), 0);
        for span in &*spans {
            for end in &mut ends[span.start as usize..span.end as usize] {
                *end += 1;
            }
        }
        let mut offset = 0;
        for end in &mut *ends {
            (*end, offset) = (offset, offset + *end);
        }
        lists.clear();
        lists.resize(offset as usize, 0);
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
