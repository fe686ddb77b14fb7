//! Near-to-far compositing of a tile's splats.
//!
//! A splat is blended in two loops over the vectors that it covers: its opacities first, then the light. In one loop the chain of steps from a
//! pixel's place to its colour is so long that a processor has hardly more than one vector in work at a time
//! (docs/journal/2026-11-instruction-sets.md, *Two steps*).

use super::bin::Bins;
use super::local::{Batch, Limits, Local};
use super::project::Splats;
use super::tile::{
    Buffer, LANES, PATCHES, Place, Plane, Strips, at, integers_at, origin, patch, put, put_integers,
};
use super::{Grid, TILE};
use crate::RenderSettings;
use cpu_kernels::pulp::{Simd, WithSimd, cast};
use cpu_kernels::vector::{neg, select};
use cpu_kernels::{Isa, dispatch};
use rayon::prelude::*;

/// The pixels of a tile while splats are added.
struct Tile<'a> {
    colours: &'a mut Colours,
    trace: &'a mut Trace,
}

/// The colours of a tile so far, without what shows of the background.
#[derive(Clone)]
#[repr(align(64))]
struct Colours([Plane; 3]);

/// What the pass backward needs to know of the pixels of a tile.
#[derive(Debug)]
#[repr(align(64))]
pub(super) struct Trace {
    /// What is left of the light from behind; its sign is negative where the pixel is done.
    pub(super) transmittance: Plane,
    /// Place in the tile's list of the splat at which the pixel was done, counted from 1: neither it nor what follows is drawn. 0 beyond the
    /// image's edge, [`NEVER`] where the pixel never was. (There is always light left: `transmittance_min` is above 0 and `alpha_max` below 1.)
    pub(super) done: Plane<i32>,
    /// Where each splat of the tile's list may be drawn, up to the last that may be drawn anywhere.
    pub(super) strips: Vec<Strips>,
    /// Σ w and Σ w (z - `nearest`), kept only when depth is asked for.
    pub(super) weight: Plane,
    pub(super) depth: Plane,
    /// z-depth of the tile's first splat. Depths are taken from here: of a thin layer f32 would leave little else.
    pub(super) nearest: f32,
}

/// A place that no splat has. Not the largest number: of the smaller of it and what is stored the compiler would know that it changes nothing, and
/// make a masked store.
const NEVER: i32 = i32::MAX - 1;

/// What blending reads, and the instruction set that it uses.
#[derive(Clone, Copy)]
pub(super) struct Lists<'a> {
    pub(super) splats: &'a Splats,
    pub(super) bins: &'a Bins,
    pub(super) grid: Grid,
    pub(super) isa: Isa,
}

/// Blends every tile into `image` `[h, w, 3]`, `alpha` `[h, w]` and `depth` (`[h, w]`, or empty if not asked for). Leaves the
/// traces of the tiles in `traces` if `record`.
pub(super) fn blend(
    lists: Lists,
    settings: &RenderSettings,
    record: bool,
    (image, alpha, depth): (&mut [f32], &mut [f32], &mut [f32]),
    traces: &mut Vec<Trace>,
) {
    let grid = lists.grid;
    let limits = Limits::new(settings);
    let blend_tile = if settings.depth { blend_tile::<true> } else { blend_tile::<false> };
    let band = TILE * grid.width;
    let mut depth_bands: Vec<&mut [f32]> = if depth.is_empty() {
        (0..grid.rows).map(|_| <&mut [f32]>::default()).collect()
    } else {
        depth.chunks_mut(band).collect()
    };
    if record && traces.len() != grid.tiles() {
        traces.clear();
        traces.shrink_to(grid.tiles());
        traces.resize_with(grid.tiles(), Trace::new);
    }
    let mut kept: Vec<&mut [Trace]> = if record {
        traces.chunks_mut(grid.columns).collect()
    } else {
        (0..grid.rows).map(|_| <&mut [Trace]>::default()).collect()
    };
    image
        .par_chunks_mut(band * 3)
        .zip(alpha.par_chunks_mut(band))
        .zip(&mut depth_bands)
        .zip(&mut kept)
        .enumerate()
        .for_each_init(RowOfTiles::default, |room, (row, (((image, alpha), depth), kept))| {
            room.colours.resize(grid.columns, Colours([[[0.0; LANES]; PATCHES]; 3]));
            let traces = if record {
                &mut kept[..]
            } else {
                room.traces.resize_with(grid.columns, Trace::new);
                &mut room.traces[..]
            };
            let tiles = room.colours.par_iter_mut().zip(&mut *traces);
            tiles.enumerate().for_each(|(column, (colours, trace))| {
                let mut tile = Tile { colours, trace };
                tile.clear(grid, column, row);
                blend_tile(tile, lists, row * grid.columns + column, limits);
            });
            for (y, alpha) in alpha.chunks_exact_mut(grid.width).enumerate() {
                for (x, alpha) in alpha.iter_mut().enumerate() {
                    let (tile, pixel) = (x / TILE, y * grid.width + x);
                    let (Colours(rgb), trace) = (&room.colours[tile], &traces[tile]);
                    let (patch, lane) = patch(x % TILE, y);
                    let transmittance = trace.transmittance[patch][lane].abs();
                    *alpha = 1.0 - transmittance;
                    for channel in 0..3 {
                        image[pixel * 3 + channel] =
                            rgb[channel][patch][lane] + transmittance * settings.background[channel];
                    }
                    let weight = trace.weight[patch][lane];
                    if let Some(depth) = depth.get_mut(pixel).filter(|_| weight > 0.0) {
                        *depth = trace.nearest + trace.depth[patch][lane] / weight;
                    }
                }
            }
        });
}

/// Memory for a row of tiles; the traces only where they are not kept.
#[derive(Default)]
struct RowOfTiles {
    colours: Vec<Colours>,
    traces: Vec<Trace>,
}

impl Trace {
    fn new() -> Self {
        Self {
            transmittance: [[0.0; LANES]; PATCHES],
            done: [[0; LANES]; PATCHES],
            strips: Vec::new(),
            weight: [[0.0; LANES]; PATCHES],
            depth: [[0.0; LANES]; PATCHES],
            nearest: 0.0,
        }
    }
}

impl Tile<'_> {
    /// Makes it a tile before the first splat; pixels beyond the image's edge count as done.
    fn clear(&mut self, grid: Grid, column: usize, row: usize) {
        self.colours.0 = [[[0.0; LANES]; PATCHES]; 3];
        let mut strips = std::mem::take(&mut self.trace.strips);
        strips.clear();
        *self.trace = Trace { strips, ..Trace::new() };
        self.trace.transmittance = [[-1.0; LANES]; PATCHES];
        for y in 0..TILE.min(grid.height - row * TILE) {
            for x in 0..TILE.min(grid.width - column * TILE) {
                let (patch, lane) = patch(x, y);
                (self.trace.transmittance[patch][lane], self.trace.done[patch][lane]) = (1.0, NEVER);
            }
        }
    }
}

/// Adds the splats of tile number `index` to `tile`.
fn blend_tile<const DEPTH: bool>(tile: Tile<'_>, lists: Lists, index: usize, limits: Limits) {
    dispatch(lists.isa, Blend::<DEPTH> { tile, lists, index, limits });
}

struct Blend<'a, const DEPTH: bool> {
    tile: Tile<'a>,
    lists: Lists<'a>,
    index: usize,
    limits: Limits,
}

impl<const DEPTH: bool> WithSimd for Blend<'_, DEPTH> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, lists, index, limits } = self;
        let origin = origin(lists.grid, index);
        let Tile { colours: Colours(rgb), trace } = tile;
        // Splats between two looks for pixels that are not done.
        const GROUP: usize = 8;
        let mut batch = Batch::EMPTY;
        let mut indices = lists.bins.pieces(index).flatten();
        let mut alphas = Buffer::EMPTY;
        let alphas = alphas.vectors::<S>();
        let mut lit = Strips::NONE;
        // Kept from pass to pass, unless it is far too large.
        let count = lists.bins.len(index);
        trace.strips.shrink_to(4 * count);
        trace.strips.reserve(count);
        'lists: loop {
            batch.fetch(lists.splats, &mut indices, origin);
            if batch.splats().is_empty() {
                break;
            }
            for (splat, strips) in batch.splats().iter().zip(batch.strips(simd, limits)) {
                let before = trace.strips.len();
                if before == 0 {
                    trace.nearest = splat.depth;
                }
                if before % GROUP == 0 {
                    lit = Strips::above_zero(simd, &trace.transmittance);
                    if lit.is_empty() {
                        break 'lists;
                    }
                }
                let strips = strips.and(lit);
                trace.strips.push(strips);
                strips.for_each::<S>(
                    #[inline(always)]
                    |k, place| {
                        let touch = splat.touch(simd, place, limits);
                        let alpha = simd.min_f32s(touch.alpha, simd.splat_f32s(limits.alpha_max));
                        alphas[k] = select(simd, touch.is_seen, alpha, simd.splat_f32s(0.0));
                    },
                );
                strips.for_each::<S>(
                    #[inline(always)]
                    |k, place| {
                        let (tile, splat) = ((&mut *rgb, &mut *trace), (splat, before as i32 + 1));
                        blend_vector::<S, DEPTH>(simd, tile, splat, place, alphas[k], limits);
                    },
                );
            }
        }
        while trace.strips.pop_if(|strips| strips.is_empty()).is_some() {}
    }
}

/// Adds a splat, which is that `number` of the tile, counted from 1, to a vector of pixels.
#[inline(always)]
fn blend_vector<S: Simd, const DEPTH: bool>(
    simd: S,
    (rgb, trace): (&mut [Plane; 3], &mut Trace),
    (splat, number): (&Local, i32),
    place: Place,
    alpha: S::f32s,
    limits: Limits,
) {
    let all = |v: f32| simd.splat_f32s(v);
    let zero = all(0.0);
    let before = at::<S>(&trace.transmittance, place);
    // A share of 0 changes nothing: no select of what is stored, which would be a masked store.
    let share = select(simd, simd.greater_than_f32s(before, zero), alpha, zero);
    let after = simd.mul_f32s(before, simd.sub_f32s(all(1.0), share));
    // Where the splat would leave too little light it is not drawn, and the pixel is done.
    let dark = simd.less_than_f32s(after, all(limits.transmittance_min));
    let stops = simd.and_m32s(dark, simd.greater_than_f32s(share, zero));
    let weight = simd.mul_f32s(before, select(simd, stops, zero, share));
    put::<S>(&mut trace.transmittance, place, select(simd, stops, neg(simd, before), after));
    let here = simd.select_u32s(stops, cast(simd.splat_i32s(number)), cast(simd.splat_i32s(NEVER)));
    let done = simd.min_i32s(integers_at::<S>(&trace.done, place), cast(here));
    put_integers::<S>(&mut trace.done, place, done);
    for (channel, &colour) in rgb.iter_mut().zip(&splat.rgb) {
        let sum = simd.mul_add_e_f32s(weight, all(colour), at::<S>(channel, place));
        put::<S>(channel, place, sum);
    }
    if DEPTH {
        let sum = simd.add_f32s(at::<S>(&trace.weight, place), weight);
        put::<S>(&mut trace.weight, place, sum);
        let depth = all(splat.depth - trace.nearest);
        let sum = simd.mul_add_e_f32s(weight, depth, at::<S>(&trace.depth, place));
        put::<S>(&mut trace.depth, place, sum);
    }
}
