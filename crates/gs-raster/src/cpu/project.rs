//! Gaussians to splats, block by block, chunk by chunk.

use super::footprint::{BLOCK, Columns, View, log2_alpha_bound};
use super::sh::COEFFICIENTS_MAX;
use super::shape::{CULLED, DRAWN, FindBasis, FindShapes, FirstLook, REJECTED, Shapes, find_colours};
use super::span::{Bounds, Span, Tiles};
use super::{Grid, Source};
use crate::settings::INTERSECTIONS_MAX;
use crate::{RenderSettings, Result};
use cpu_kernels::lanes::dispatch;
use cpu_kernels::{Isa, compiled_for};
use gs_scene::{Camera, Gaussians, sh_coefficients};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// log₂ of [`CHUNK`].
const CHUNK_BITS: u32 = 12;
/// Gaussians per task; fixed, so that the result does not depend on the number of threads.
pub(super) const CHUNK: usize = 1 << CHUNK_BITS;

/// Splats that are fetched together: by depth, neighbours lie far apart in memory, and the waits for them overlap.
pub(super) const BATCH: usize = 32;

/// The footprint of one Gaussian in the image: one cache line of 64 bytes.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Splat {
    /// Centre, pixels.
    pub(super) mean: [f64; 2],
    /// (p, r): in a pixel at (dx, dy) from the centre, log₂ of the falloff is p (dx - shear dy)² + r dy². This form of
    /// the quadratic adds terms of one sign, where p dx² + q dx dy + r dy² would cancel for needles.
    pub(super) falloff: [f32; 2],
    /// log₂ of the opacity.
    pub(super) log2_opacity: f32,
    /// Colour. Where it was cut at 0 from below, and so has no gradient, it is -0.
    pub(super) rgb: [f32; 3],
    /// z-depth of the centre, scene units.
    pub(super) depth: f32,
    /// dx of the middle of the ellipse's row at dy = 1 (its centre's is at 0).
    pub(super) shear: f32,
    /// Half width of the ellipse outside which alpha is below `alpha_min`, pixels.
    pub(super) half_width: f32,
    /// Which Gaussian of its chunk.
    pub(super) gaussian: u32,
}

impl Splat {
    /// What is nowhere.
    pub(super) const NONE: Self = Self {
        mean: [0.0; 2],
        falloff: [0.0; 2],
        log2_opacity: 0.0,
        rgb: [0.0; 3],
        depth: 0.0,
        shear: 0.0,
        half_width: 0.0,
        gaussian: 0,
    };
}

/// What is left of a scene in one view: chunk by chunk the visible Gaussians, in the order of the scene.
#[derive(Debug, Default)]
pub(super) struct Splats {
    chunks: Vec<Chunk>,
}

/// What is left of [`CHUNK`] Gaussians.
#[derive(Debug, Default)]
struct Chunk {
    splats: Vec<Splat>,
    /// The bits of their depths, which order as the depths do, because those are not negative.
    depths: Vec<u32>,
    tiles: Vec<Tiles>,
    /// The tiles of splats that are in several rows of tiles.
    spans: Vec<Span>,
    /// Pairs of splat and tile.
    intersections: u64,
    rejected: usize,
    /// Whether a number is none of a Gaussian, so that the rest means nothing.
    is_faulty: bool,
}

impl Splats {
    /// Projects every Gaussian of a scene; what was here is forgotten.
    ///
    /// # Errors
    /// If an activated Gaussian has a number that no Gaussian has.
    pub(super) fn project(
        &mut self,
        source: Source<'_>,
        camera: &Camera,
        settings: &RenderSettings,
        grid: Grid,
        isa: Isa,
    ) -> Result<()> {
        let view = View::new(camera, settings);
        let limit = log2_alpha_bound(settings);
        let frame = Frame { grid, limit, intersections: &AtomicU64::new(0) };
        let project_chunk = match (source.sh_degree(), isa > Isa::Scalar) {
            (0, true) => project_chunk::<0, true>,
            (1, true) => project_chunk::<1, true>,
            (2, true) => project_chunk::<2, true>,
            (_, true) => project_chunk::<3, true>,
            (0, false) => project_chunk::<0, false>,
            (1, false) => project_chunk::<1, false>,
            (2, false) => project_chunk::<2, false>,
            (_, false) => project_chunk::<3, false>,
        };
        self.chunks.resize_with(source.len().div_ceil(CHUNK), Chunk::default);
        self.chunks.par_iter_mut().enumerate().for_each(|(index, chunk)| {
            let gaussians = index * CHUNK..source.len().min((index + 1) * CHUNK);
            project_chunk(isa, chunk, &view, frame, source, gaussians);
        });
        match source {
            // Numbers that are not used may be at fault, which is none.
            Source::Activated(gaussians) if self.chunks.iter().any(|chunk| chunk.is_faulty) => {
                gaussians.check_numbers()
            }
            _ => Ok(()),
        }
    }

    /// The splat of an index; not all numbers below [`Splats::end`] are one.
    #[inline(always)]
    pub(super) fn get(&self, index: u32) -> &Splat {
        &self.chunks[(index >> CHUNK_BITS) as usize].splats[index as usize % CHUNK]
    }

    /// The tiles of a splat.
    #[inline(always)]
    pub(super) fn tiles(&self, index: u32) -> Tiles {
        self.chunks[(index >> CHUNK_BITS) as usize].tiles[index as usize % CHUNK]
    }

    /// Spans of the chunk of the splat of an index.
    #[inline(always)]
    pub(super) fn spans(&self, index: u32, first: u32, count: u32) -> &[Span] {
        &self.chunks[(index >> CHUNK_BITS) as usize].spans[first as usize..(first + count) as usize]
    }

    /// Copies the splats of at most [`BATCH`] indices to `batch`, and returns them.
    #[inline(always)]
    pub(super) fn fetch<'a>(&self, indices: &[u32], batch: &'a mut [Splat; BATCH]) -> &'a [Splat] {
        for (splat, &index) in batch.iter_mut().zip(indices) {
            *splat = *self.get(index);
        }
        &batch[..indices.len()]
    }

    /// The splats of each chunk; the first of chunk k has index k · [`CHUNK`].
    pub(super) fn chunks(&self) -> impl IndexedParallelIterator<Item = &[Splat]> {
        self.chunks.par_iter().map(|chunk| chunk.splats.as_slice())
    }

    /// As [`Splats::chunks`], the bits of the depths: they order as the depths do, which are not negative.
    pub(super) fn depths(&self) -> impl IndexedParallelIterator<Item = &[u32]> {
        self.chunks.par_iter().map(|chunk| chunk.depths.as_slice())
    }

    /// All indices are below this.
    pub(super) fn end(&self) -> usize {
        self.chunks.len() * CHUNK
    }

    /// How many there are.
    pub(super) fn visible(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.splats.len()).sum()
    }

    /// Pairs of splat and tile. If they are too many to be listed, the spans are incomplete.
    pub(super) fn intersections(&self) -> u64 {
        self.chunks.iter().map(|chunk| chunk.intersections).sum()
    }

    /// See [`RenderStats::rejected`](crate::RenderStats::rejected).
    pub(super) fn rejected(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.rejected).sum()
    }
}

impl Chunk {
    /// Forgets everything and makes room for `count` splats.
    fn clear(&mut self, count: usize) {
        let Self { splats, depths, tiles, spans, intersections, rejected, is_faulty } = self;
        splats.clear();
        splats.reserve_exact(count);
        depths.clear();
        depths.reserve_exact(count);
        tiles.clear();
        tiles.reserve_exact(count);
        spans.clear();
        (*intersections, *rejected, *is_faulty) = (0, 0, false);
    }

    /// Adds a splat; its tiles are only counted unless `keep`.
    #[inline(always)]
    fn push(&mut self, splat: Splat, bounds: Bounds, frame: Frame, keep: bool) {
        let first = self.spans.len();
        let mut found = (0, Span { start: 0, end: 0 });
        bounds.for_each_span(&splat, frame.grid, frame.limit, |span| {
            self.intersections += u64::from(span.end - span.start);
            if found.0 > 0 && keep {
                if found.0 == 1 {
                    self.spans.push(found.1);
                }
                self.spans.push(span);
            }
            found = (found.0 + 1, span);
        });
        self.tiles.push(match found {
            (1, span) => Tiles::One(span),
            (count, _) => Tiles::Several { first: first as u32, count: if keep { count } else { 0 } },
        });
        self.depths.push(splat.depth.to_bits());
        self.splats.push(splat);
    }
}

/// What the chunks of a view share.
#[derive(Clone, Copy)]
struct Frame<'a> {
    grid: Grid,
    /// log₂ of alpha at which the ellipses end.
    limit: f32,
    /// Pairs of splat and tile found so far.
    intersections: &'a AtomicU64,
}

/// Projects the Gaussians of a chunk.
fn project_chunk<const DEGREE: usize, const FMA: bool>(
    isa: Isa,
    chunk: &mut Chunk,
    view: &View,
    frame: Frame,
    source: Source<'_>,
    gaussians: Range<usize>,
) {
    compiled_for!(isa, project_blocks::<DEGREE, FMA>(isa, chunk, view, frame, source, gaussians));
}

/// Projects the Gaussians of a chunk block by block. Each step is a function of its own for the compiler, as their loops
/// need all registers.
#[inline(always)]
fn project_blocks<const DEGREE: usize, const FMA: bool>(
    isa: Isa,
    chunk: &mut Chunk,
    view: &View,
    frame: Frame,
    source: Source<'_>,
    gaussians: Range<usize>,
) {
    chunk.clear(gaussians.len());
    let sh_row = sh_coefficients(DEGREE) * 3;
    let first = gaussians.start;
    let mut columns = Columns::new(source.is_activated());
    let mut outcomes = [CULLED; BLOCK];
    let mut numbers = [0; BLOCK];
    let mut room = [0.0; BLOCK * 3 * COEFFICIENTS_MAX];
    let mut shapes = Shapes::new();
    let mut basis = [[0.0; BLOCK]; COEFFICIENTS_MAX];
    let mut colours = [[0.0; 3]; BLOCK];
    for start in gaussians.clone().step_by(BLOCK) {
        let n = BLOCK.min(gaussians.end - start);
        let sh = match source {
            Source::Stored(scene) => {
                let rows = scene.geometry()[start * Gaussians::GEOMETRY..].chunks_exact(Gaussians::GEOMETRY);
                for (place, row) in rows.take(n).enumerate() {
                    columns.set(place, row);
                }
                &scene.sh()[start * sh_row..][..n * sh_row]
            }
            Source::Activated(activated) => {
                let part = activated.part(start, n);
                chunk.is_faulty |= compiled_for!(isa, !part.is_good());
                for place in 0..n {
                    columns.set_activated(place, &part, place);
                }
                part.sh(&mut room)
            }
        };
        dispatch(isa, FirstLook { outcomes: &mut outcomes, view, columns: &columns, count: n });
        let mut kept = 0;
        for (gaussian, &outcome) in outcomes[..n].iter().enumerate() {
            chunk.rejected += usize::from(outcome == REJECTED);
            if outcome == DRAWN {
                if kept < gaussian {
                    columns.copy(gaussian, kept);
                }
                numbers[kept] = gaussian;
                kept += 1;
            }
        }
        if kept == 0 {
            continue;
        }
        // Once there are too many pairs they only are counted.
        let before = chunk.intersections;
        let keep = frame.intersections.load(Ordering::Relaxed) <= INTERSECTIONS_MAX;
        dispatch(isa, FindShapes { shapes: &mut shapes, view, columns: &columns, count: kept });
        let direction = &shapes.direction;
        dispatch(isa, FindBasis::<DEGREE> { basis: &mut basis, direction, count: kept });
        compiled_for!(isa, find_colours::<DEGREE, FMA>(&mut colours, &basis, &numbers[..kept], sh));
        for (place, gaussian) in numbers[..kept].iter().enumerate() {
            let rgb = colours[place];
            if shapes.outcome[place] != DRAWN {
                chunk.rejected += usize::from(shapes.outcome[place] == REJECTED);
            } else if rgb.iter().all(|channel| channel.is_finite()) {
                let rgb = rgb.map(|channel| if channel < 0.0 { -0.0 } else { channel });
                let gaussian = (start - first + gaussian) as u32;
                chunk.push(shapes.splat(place, rgb, gaussian), shapes.bounds(place), frame, keep);
            } else {
                chunk.rejected += 1;
            }
        }
        frame.intersections.fetch_add(chunk.intersections - before, Ordering::Relaxed);
    }
}
