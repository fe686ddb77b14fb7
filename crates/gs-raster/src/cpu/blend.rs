//! Near-to-far compositing of a tile's splats, some pixels of a row at a time.
//!
//! The loops over lanes have a fixed length and no branches, so that the compiler turns them into vector
//! instructions; the function around them is compiled for several instruction sets and chosen at run time.

use super::bin::Bins;
use super::math::{exp2, mul_add};
use super::project::{Splat, Splats};
use super::{Grid, TILE};
use crate::RenderSettings;
use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;

/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE * TILE;
/// Splats between two looks at whether the whole tile is done.
const DONE_INTERVAL: u32 = 32;

/// One number per pixel of a tile, rows of [`TILE`].
pub(super) type Plane<T = f32> = [T; PIXELS];

/// The pixels of a tile while splats are added.
#[repr(align(64))]
struct Tile {
    rgb: [Plane; 3],
    trace: Trace,
}

/// What the pass backward needs to know of the pixels of a tile.
#[derive(Debug)]
#[repr(align(64))]
pub(super) struct Trace {
    /// What is left of the light from behind; its sign is negative where the pixel is done.
    pub(super) transmittance: Plane,
    /// Place in the tile's list of the last splat that is drawn in the pixel, counted from 1; 0 where there is none. Kept
    /// only when recording.
    pub(super) last: Plane<u32>,
    /// Σ w and Σ w (z - `nearest`), kept only when depth is asked for.
    pub(super) weight: Plane,
    pub(super) depth: Plane,
    /// z-depth of the tile's first splat. Depths are taken from here: of a thin layer f32 would leave little else.
    pub(super) nearest: f32,
}

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

/// What blending reads.
#[derive(Clone, Copy)]
pub(super) struct Lists<'a> {
    pub(super) splats: &'a Splats,
    pub(super) bins: &'a Bins,
    pub(super) grid: Grid,
}

/// Blends every tile into `image` `[h, w, 3]`, `alpha` `[h, w]` and `depth` (`[h, w]`, or empty if not asked for). Returns
/// the traces of the tiles if `record`.
pub(super) fn blend(
    lists: Lists,
    settings: &RenderSettings,
    record: bool,
    image: &mut [f32],
    alpha: &mut [f32],
    depth: &mut [f32],
) -> Vec<Trace> {
    let grid = lists.grid;
    let limits = Limits::new(settings);
    let blend_tile = match (settings.depth, record) {
        (false, false) => blend_tile::<false, false>,
        (false, true) => blend_tile::<false, true>,
        (true, false) => blend_tile::<true, false>,
        (true, true) => blend_tile::<true, true>,
    };
    let band = TILE * grid.width;
    let mut depth_bands: Vec<&mut [f32]> = if depth.is_empty() {
        (0..grid.rows).map(|_| <&mut [f32]>::default()).collect()
    } else {
        depth.chunks_mut(band).collect()
    };
    let traces: Vec<Vec<Trace>> = image
        .par_chunks_mut(band * 3)
        .zip(alpha.par_chunks_mut(band))
        .zip(&mut depth_bands)
        .enumerate()
        .map(|(row, ((image, alpha), depth))| {
            let tiles: Vec<Box<Tile>> = (0..grid.columns)
                .into_par_iter()
                .map(|column| {
                    let mut tile = Tile::new(grid, column, row);
                    blend_tile(&mut tile, lists, row * grid.columns + column, limits);
                    tile
                })
                .collect();
            for (y, alpha) in alpha.chunks_exact_mut(grid.width).enumerate() {
                for (x, alpha) in alpha.iter_mut().enumerate() {
                    let (tile, pixel, at) = (&tiles[x / TILE], y * TILE + x % TILE, y * grid.width + x);
                    let transmittance = tile.trace.transmittance[pixel].abs();
                    *alpha = 1.0 - transmittance;
                    for channel in 0..3 {
                        image[at * 3 + channel] =
                            tile.rgb[channel][pixel] + transmittance * settings.background[channel];
                    }
                    if let Some(depth) = depth.get_mut(at).filter(|_| tile.trace.weight[pixel] > 0.0) {
                        *depth = tile.trace.nearest + tile.trace.depth[pixel] / tile.trace.weight[pixel];
                    }
                }
            }
            if record { tiles.into_iter().map(|tile| tile.trace).collect() } else { Vec::new() }
        })
        .collect();
    traces.into_iter().flatten().collect()
}

impl Tile {
    /// A tile before the first splat; pixels beyond the image's edge count as done.
    fn new(grid: Grid, column: usize, row: usize) -> Box<Self> {
        let mut tile = Box::new(Self {
            rgb: [[0.0; PIXELS]; 3],
            trace: Trace {
                transmittance: [-1.0; PIXELS],
                last: [0; PIXELS],
                weight: [0.0; PIXELS],
                depth: [0.0; PIXELS],
                nearest: 0.0,
            },
        });
        let width = TILE.min(grid.width - column * TILE);
        let height = TILE.min(grid.height - row * TILE);
        for row in tile.trace.transmittance.chunks_exact_mut(TILE).take(height) {
            row[..width].fill(1.0);
        }
        tile
    }
}

/// A splat as one tile sees it, pixels from the tile's top-left corner: there, f32 keeps the position to a millionth of a
/// pixel in images of any size.
pub(super) struct Local {
    pub(super) x: f32,
    pub(super) y: f32,
    /// Rows that the ellipse may touch.
    pub(super) first: usize,
    pub(super) end: usize,
    /// Steps of L pixels in a row that it may touch; finer tests cost more than they save.
    pub(super) first_step: usize,
    pub(super) end_step: usize,
}

impl Local {
    #[inline(always)]
    pub(super) fn new<const L: usize>(splat: &Splat, origin: [f64; 2]) -> Self {
        let x = (splat.mean[0] - origin[0]) as f32;
        let y = (splat.mean[1] - origin[1]) as f32;
        let bottom = (TILE - 1) as f32;
        let first = (y - splat.extent[1] - 0.5).ceil().max(0.0).min(bottom + 1.0);
        let end = (y + splat.extent[1] - 0.5).floor().max(-1.0).min(bottom) + 1.0;
        // The centres of the last pixel of the left half and of the first of the right half.
        let half = L as f32;
        let halves = L < TILE;
        let first_step = usize::from(halves & (x - splat.extent[0] > half - 0.5));
        let end_step = if halves & (x + splat.extent[0] >= half + 0.5) { 2 } else { 1 };
        // In the range of i32: casts to it are single instructions.
        let [first, end] = [first, end].map(|row| row as i32 as usize);
        Self { x, y, first, end, first_step, end_step }
    }
}

/// The top-left corner of a tile, pixels.
pub(super) fn origin(grid: Grid, tile: usize) -> [f64; 2] {
    [(tile % grid.columns * TILE) as f64, (tile / grid.columns * TILE) as f64]
}

/// Adds the splats of tile number `index` to `tile`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn blend_tile<const DEPTH: bool, const RECORD: bool>(
    tile: &mut Tile,
    lists: Lists,
    index: usize,
    limits: Limits,
) {
    if target_cfg_f!(target_feature = "avx512f") {
        blend_tile_with::<DEPTH, RECORD, true, 16>(tile, lists, index, limits);
    } else if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        blend_tile_with::<DEPTH, RECORD, true, 8>(tile, lists, index, limits);
    } else {
        blend_tile_with::<DEPTH, RECORD, false, 8>(tile, lists, index, limits);
    }
}

#[inline(always)]
fn blend_tile_with<const DEPTH: bool, const RECORD: bool, const FMA: bool, const L: usize>(
    tile: &mut Tile,
    lists: Lists,
    index: usize,
    limits: Limits,
) {
    let centres = centres();
    let origin = origin(lists.grid, index);
    let Tile { rgb, trace } = tile;
    let mut place = 0u32;
    for &splat in lists.bins.pieces(index).flatten() {
        if place % DONE_INTERVAL == DONE_INTERVAL - 1 && trace.transmittance.iter().all(|&t| t <= 0.0) {
            return;
        }
        place += 1;
        let splat = lists.splats.get(splat);
        if place == 1 {
            trace.nearest = splat.depth;
        }
        let local = Local::new::<L>(splat, origin);
        for row in local.first..local.end {
            for step in local.first_step..local.end_step {
                let at = row * TILE + step * L;
                let falloff = Falloff::<L>::new::<FMA>(splat, &local, &centres, row, step, limits);
                let mut weight = [0.0; L];
                {
                    let transmittance = lanes::<_, L>(&mut trace.transmittance, at);
                    let last = lanes::<_, L>(&mut trace.last, at);
                    for lane in 0..L {
                        let alpha = falloff.alpha[lane];
                        let before = transmittance[lane];
                        let drawn = falloff.drawn[lane] & (before > 0.0);
                        let stops = before * (1.0 - alpha) < limits.transmittance_min;
                        weight[lane] = if drawn & !stops { before * alpha } else { 0.0 };
                        // A product, because the compiler turns a choice into a masked store, which is slow.
                        let factor = if stops { -1.0 } else { 1.0 - alpha };
                        transmittance[lane] = before * if drawn { factor } else { 1.0 };
                        if RECORD {
                            last[lane] = if drawn & !stops { place } else { last[lane] };
                        }
                    }
                }
                for (channel, &colour) in rgb.iter_mut().zip(&splat.rgb) {
                    accumulate::<FMA, L>(lanes(channel, at), &weight, colour);
                }
                if DEPTH {
                    accumulate::<FMA, L>(lanes(&mut trace.weight, at), &weight, 1.0);
                    let depth = splat.depth - trace.nearest;
                    accumulate::<FMA, L>(lanes(&mut trace.depth, at), &weight, depth);
                }
            }
        }
    }
}

/// The centres of the pixels of a row or a column of a tile.
#[inline(always)]
pub(super) fn centres() -> [f32; TILE] {
    std::array::from_fn(|i| i as f32 + 0.5)
}

/// A splat in some pixels of a row. The pass backward takes the same numbers and decisions from here.
pub(super) struct Falloff<const L: usize> {
    /// Distance from the middle of the ellipse's row, pixels.
    pub(super) dx: [f32; L],
    /// Distance of the row from the centre, pixels.
    pub(super) dy: f32,
    /// Opacity, not above `alpha_max`.
    pub(super) alpha: [f32; L],
    /// Whether the opacity is at least `alpha_min`.
    pub(super) drawn: [bool; L],
    /// Whether it was above `alpha_max`.
    pub(super) clamped: [bool; L],
}

impl<const L: usize> Falloff<L> {
    #[inline(always)]
    pub(super) fn new<const FMA: bool>(
        splat: &Splat,
        local: &Local,
        centres: &[f32; TILE],
        row: usize,
        step: usize,
        limits: Limits,
    ) -> Self {
        let dy = centres[row] - local.y;
        // The row's middle, and what the distance of the row takes from every pixel in it.
        let middle = local.x + splat.shear * dy;
        let constant = splat.falloff[1] * dy * dy + splat.log2_opacity;
        let mut found = Self { dx: [0.0; L], dy, alpha: [0.0; L], drawn: [false; L], clamped: [false; L] };
        for lane in 0..L {
            let dx = centres[step * L + lane] - middle;
            let log2_alpha = mul_add::<FMA>(splat.falloff[0] * dx, dx, constant);
            let alpha = exp2::<FMA>(log2_alpha);
            found.dx[lane] = dx;
            found.alpha[lane] = alpha.min(limits.alpha_max);
            found.drawn[lane] = log2_alpha >= limits.log2_alpha_min;
            found.clamped[lane] = alpha > limits.alpha_max;
        }
        found
    }
}

#[inline(always)]
pub(super) fn lanes<T, const L: usize>(plane: &mut Plane<T>, at: usize) -> &mut [T; L] {
    let slice = &mut plane[at..at + L];
    slice.try_into().expect("a slice of L numbers")
}

#[inline(always)]
fn accumulate<const FMA: bool, const L: usize>(sum: &mut [f32; L], weight: &[f32; L], value: f32) {
    for (sum, weight) in sum.iter_mut().zip(weight) {
        *sum = mul_add::<FMA>(*weight, value, *sum);
    }
}
