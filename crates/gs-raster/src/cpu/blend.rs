//! Near-to-far compositing of a tile's splats, a patch of 4×4 pixels at a time: of most splats it takes fewer patches
//! than rows to cover them.
//!
//! A patch is one vector of AVX-512, two of AVX2, four of NEON. Vectors that cover no row of the ellipse, or none of whose
//! pixels is drawn, are skipped.

use super::bin::Bins;
use super::math::exp2;
use super::project::{BATCH, Splat, Splats};
use super::{Grid, TILE};
use crate::RenderSettings;
use cpu_kernels::pulp::{Simd, WithSimd, cast};
use cpu_kernels::vector::{neg, select};
use cpu_kernels::{Isa, dispatch};
use rayon::prelude::*;
use std::ops::Range;

/// Side of a patch, pixels; and how many are in a row of a tile.
pub(super) const SIDE: usize = 4;
/// Pixels of a patch.
pub(super) const LANES: usize = SIDE * SIDE;
/// Patches of a tile.
pub(super) const PATCHES: usize = TILE * TILE / LANES;

/// One number per pixel of a tile, patch by patch.
pub(super) type Plane<T = f32> = [[T; LANES]; PATCHES];

/// Patch and lane of a pixel of a tile.
#[inline(always)]
pub(super) fn patch(x: usize, y: usize) -> (usize, usize) {
    (y / SIDE * SIDE + x / SIDE, y % SIDE * SIDE + x % SIDE)
}

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
    /// Place of the last splat that may be drawn in any pixel; 0 where there is none.
    pub(super) last: i32,
    /// Σ w and Σ w (z - `nearest`), kept only when depth is asked for.
    pub(super) weight: Plane,
    pub(super) depth: Plane,
    /// z-depth of the tile's first splat. Depths are taken from here: of a thin layer f32 would leave little else.
    pub(super) nearest: f32,
}

/// A place that no splat has.
const NEVER: i32 = i32::MAX;

/// Thresholds of the blending.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    pub(super) log2_alpha_min: f32,
    pub(super) alpha_max: f32,
    pub(super) transmittance_min: f32,
}

impl Limits {
    pub(super) fn new(settings: &RenderSettings) -> Self {
        Self {
            log2_alpha_min: settings.alpha_min.log2(),
            alpha_max: settings.alpha_max,
            transmittance_min: settings.transmittance_min,
        }
    }
}

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
            last: 0,
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
        *self.trace = Trace::new();
        self.trace.transmittance = [[-1.0; LANES]; PATCHES];
        for y in 0..TILE.min(grid.height - row * TILE) {
            for x in 0..TILE.min(grid.width - column * TILE) {
                let (patch, lane) = patch(x, y);
                (self.trace.transmittance[patch][lane], self.trace.done[patch][lane]) = (1.0, NEVER);
            }
        }
    }
}

/// A splat as one tile sees it, pixels from the tile's top-left corner: there, f32 keeps the position to a millionth of a
/// pixel in images of any size. The pass backward takes the same numbers and decisions from here.
pub(super) struct Local {
    x: f32,
    y: f32,
    falloff: [f32; 2],
    shear: f32,
    log2_opacity: f32,
    /// First and last row of pixels that the ellipse may touch.
    lines: [usize; 2],
    /// Rows and columns of patches that the ellipse may touch.
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
}

/// A splat in a vector of pixels of each patch of a row.
pub(super) struct Row<S: Simd> {
    /// Centres of the pixels in the first column of patches, from the tile's left edge.
    across: S::f32s,
    /// Distance of the pixels from the centre of the ellipse, pixels.
    pub(super) dy: S::f32s,
    /// The middle of the ellipse's row through the pixels.
    middle: S::f32s,
    /// log₂ of the opacity there.
    log2_alpha: S::f32s,
    falloff: S::f32s,
}

/// A splat in a vector of pixels.
#[derive(Clone, Copy)]
pub(super) struct Touch<S: Simd> {
    /// Distance from the middle of the ellipse's row, pixels.
    pub(super) dx: S::f32s,
    /// log₂ of the opacity.
    log2_alpha: S::f32s,
    /// Where the opacity is at least `alpha_min`.
    pub(super) is_seen: S::m32s,
}

impl Local {
    #[inline(always)]
    pub(super) fn new(splat: &Splat, origin: [u32; 2]) -> Self {
        let x = (splat.mean[0] - f64::from(origin[0])) as f32;
        let y = (splat.mean[1] - f64::from(origin[1])) as f32;
        let [top, bottom] = splat.rows;
        let first = top.saturating_sub(origin[1]) as usize;
        let last = (bottom - origin[1]).min(TILE as u32 - 1) as usize;
        // The columns lie in the tile: casts to i32 are single instructions.
        let left = (x - splat.half_width - 0.5).ceil().max(0.0).min(TILE as f32) as i32 as usize;
        let right = (x + splat.half_width + 0.5).floor().max(0.0).min(TILE as f32) as i32 as usize;
        Self {
            x,
            y,
            falloff: splat.falloff,
            shear: splat.shear,
            log2_opacity: splat.log2_opacity,
            lines: [first, last],
            rows: first / SIDE..last / SIDE + 1,
            columns: left / SIDE..right.div_ceil(SIDE),
        }
    }

    /// Vector number `vector` of the patches of a row, unless the ellipse lies above or below its pixels.
    #[inline(always)]
    pub(super) fn row<S: Simd>(&self, simd: S, row: usize, vector: usize) -> Option<Row<S>> {
        // Centres of a patch's pixels from its corner.
        const ACROSS: [f32; LANES] = {
            let mut centres = [0.0; LANES];
            let mut lane = 0;
            while lane < LANES {
                centres[lane] = (lane % SIDE) as f32 + 0.5;
                lane += 1;
            }
            centres
        };
        const DOWN: [f32; LANES] = {
            let mut centres = [0.0; LANES];
            let mut lane = 0;
            while lane < LANES {
                centres[lane] = (lane / SIDE) as f32 + 0.5;
                lane += 1;
            }
            centres
        };
        let first = row * SIDE + vector * S::F32_LANES / SIDE;
        let last = row * SIDE + (vector * S::F32_LANES + S::F32_LANES - 1) / SIDE;
        if last < self.lines[0] || first > self.lines[1] {
            return None;
        }
        let splat = |v: f32| simd.splat_f32s(v);
        let down = simd.add_f32s(vectors::<S>(&DOWN)[vector], splat((row * SIDE) as i32 as f32));
        let dy = simd.sub_f32s(down, splat(self.y));
        let falloff = simd.mul_f32s(simd.mul_f32s(splat(self.falloff[1]), dy), dy);
        Some(Row {
            across: vectors::<S>(&ACROSS)[vector],
            dy,
            middle: simd.add_f32s(splat(self.x), simd.mul_f32s(splat(self.shear), dy)),
            log2_alpha: simd.add_f32s(falloff, splat(self.log2_opacity)),
            falloff: splat(self.falloff[0]),
        })
    }
}

impl<S: Simd> Row<S> {
    #[inline(always)]
    pub(super) fn touch(&self, simd: S, column: usize, limits: Limits) -> Touch<S> {
        let across = simd.add_f32s(self.across, simd.splat_f32s((column * SIDE) as i32 as f32));
        let dx = simd.sub_f32s(across, self.middle);
        let log2_alpha = simd.mul_add_e_f32s(simd.mul_f32s(self.falloff, dx), dx, self.log2_alpha);
        let least = simd.splat_f32s(limits.log2_alpha_min);
        Touch { dx, log2_alpha, is_seen: simd.greater_than_or_equal_f32s(log2_alpha, least) }
    }
}

impl<S: Simd> Touch<S> {
    /// The opacity, and that not above `alpha_max`.
    #[inline(always)]
    pub(super) fn alpha(&self, simd: S, limits: Limits) -> (S::f32s, S::f32s) {
        let alpha = exp2(simd, self.log2_alpha);
        (alpha, simd.min_f32s(alpha, simd.splat_f32s(limits.alpha_max)))
    }
}

/// A patch in vectors.
#[inline(always)]
pub(super) fn vectors<S: Simd>(lanes: &[f32; LANES]) -> &[S::f32s] {
    S::as_simd_f32s(lanes).0
}

/// A patch in vectors that can be written.
#[inline(always)]
pub(super) fn vectors_mut<S: Simd>(lanes: &mut [f32; LANES]) -> &mut [S::f32s] {
    S::as_mut_simd_f32s(lanes).0
}

/// Whether a mask is true anywhere.
#[inline(always)]
pub(super) fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}

/// The top-left corner of a tile, pixels.
pub(super) fn origin(grid: Grid, tile: usize) -> [u32; 2] {
    [(tile % grid.columns * TILE) as u32, (tile / grid.columns * TILE) as u32]
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
        let mut place = 0;
        let mut batch = [Splat::NONE; BATCH];
        for indices in lists.bins.pieces(index).flat_map(|piece| piece.chunks(BATCH)) {
            if trace.transmittance.iter().flatten().all(|&t| t <= 0.0) {
                return;
            }
            for splat in lists.splats.fetch(indices, &mut batch) {
                place += 1;
                if place == 1 {
                    trace.nearest = splat.depth;
                }
                let local = Local::new(splat, origin);
                for y in local.rows.clone() {
                    for v in 0..LANES / S::F32_LANES {
                        if let Some(row) = local.row(simd, y, v) {
                            for x in local.columns.clone() {
                                let target = Place { patch: (y * SIDE + x) % PATCHES, v, place };
                                blend_vector::<S, DEPTH>(
                                    simd,
                                    (rgb, trace),
                                    splat,
                                    target,
                                    row.touch(simd, x, limits),
                                    limits,
                                );
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Which patch of a tile, which vector of the patch, and which splat of the tile, counted from 1.
#[derive(Clone, Copy)]
struct Place {
    patch: usize,
    v: usize,
    place: i32,
}

/// Adds a splat to a vector of pixels.
#[inline(always)]
fn blend_vector<S: Simd, const DEPTH: bool>(
    simd: S,
    (rgb, trace): (&mut [Plane; 3], &mut Trace),
    splat: &Splat,
    Place { patch, v, place }: Place,
    touch: Touch<S>,
    limits: Limits,
) {
    let transmittance = &mut vectors_mut::<S>(&mut trace.transmittance[patch])[v];
    let before = *transmittance;
    let zero = simd.splat_f32s(0.0);
    let seen = simd.and_m32s(touch.is_seen, simd.greater_than_f32s(before, zero));
    if !any(simd, seen) {
        return;
    }
    let (_, alpha) = touch.alpha(simd, limits);
    trace.last = place;
    // A share of 0 changes nothing: no select of what is stored, which would be a masked store.
    let mut share = select(simd, seen, alpha, zero);
    let mut after = simd.mul_f32s(before, simd.sub_f32s(simd.splat_f32s(1.0), share));
    let dark = simd.less_than_f32s(after, simd.splat_f32s(limits.transmittance_min));
    let stops = simd.and_m32s(seen, dark);
    if any(simd, stops) {
        // Where the splat would leave too little light it is not drawn, and the pixel is done: once, so that here a masked store may be.
        share = select(simd, stops, zero, share);
        after = select(simd, stops, neg(simd, before), after);
        let done = &mut S::as_mut_simd_i32s(&mut trace.done[patch]).0[v];
        *done = cast(simd.select_u32s(stops, cast(simd.splat_i32s(place)), cast(*done)));
    }
    *transmittance = after;
    let weight = simd.mul_f32s(before, share);
    for (channel, &colour) in rgb.iter_mut().zip(&splat.rgb) {
        let sum = &mut vectors_mut::<S>(&mut channel[patch])[v];
        *sum = simd.mul_add_e_f32s(weight, simd.splat_f32s(colour), *sum);
    }
    if DEPTH {
        let sum = &mut vectors_mut::<S>(&mut trace.weight[patch])[v];
        *sum = simd.add_f32s(*sum, weight);
        let sum = &mut vectors_mut::<S>(&mut trace.depth[patch])[v];
        *sum = simd.mul_add_e_f32s(weight, simd.splat_f32s(splat.depth - trace.nearest), *sum);
    }
}
