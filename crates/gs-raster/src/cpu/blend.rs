//! Near-to-far compositing of a tile's splats, some pixels of a row at a time.
//!
//! The loops over lanes have a fixed length and no branches, so that the compiler turns them into vector
//! instructions; the function around them is compiled for several instruction sets and chosen at run time.

use super::bin::Bins;
use super::math::{exp2, mul_add};
use super::project::{BATCH, Splat, Splats};
use super::{Grid, TILE};
use crate::RenderSettings;
use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;
use std::ops::Range;

/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE * TILE;

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
/// pixel in images of any size. The pass backward takes the same numbers and decisions from here.
pub(super) struct Local {
    x: f32,
    y: f32,
    falloff: [f32; 2],
    shear: f32,
    log2_opacity: f32,
    /// Rows that the ellipse may touch.
    pub(super) rows: Range<usize>,
    /// Steps of L pixels in a row that it may touch; finer tests cost more than they save.
    pub(super) steps: Range<usize>,
}

/// A splat in a row of a tile.
#[derive(Clone, Copy)]
pub(super) struct Row {
    /// Distance of the row from the centre, pixels.
    pub(super) dy: f32,
    /// The middle of the ellipse in the row.
    middle: f32,
    /// log₂ of the opacity there.
    log2_alpha: f32,
    falloff: f32,
}

/// A splat in a pixel.
pub(super) struct Touch {
    /// Distance from the middle of the ellipse's row, pixels.
    pub(super) dx: f32,
    /// Opacity, not above `alpha_max`.
    pub(super) alpha: f32,
    /// Whether the opacity is at least `alpha_min`.
    pub(super) is_seen: bool,
    /// Whether it is above `alpha_max`.
    pub(super) is_clamped: bool,
}

impl Local {
    #[inline(always)]
    pub(super) fn new<const L: usize>(splat: &Splat, origin: [u32; 2]) -> Self {
        let x = (splat.mean[0] - f64::from(origin[0])) as f32;
        let y = (splat.mean[1] - f64::from(origin[1])) as f32;
        let [top, bottom] = splat.rows;
        let first = top.saturating_sub(origin[1]);
        let end = (bottom + 1 - origin[1]).min(TILE as u32);
        // The centres of the last pixel of the left half and of the first of the right half.
        let half = L as f32;
        let halves = L < TILE;
        let first_step = usize::from(halves & (x - splat.half_width > half - 0.5));
        let end_step = if halves & (x + splat.half_width >= half + 0.5) { 2 } else { 1 };
        Self {
            x,
            y,
            falloff: splat.falloff,
            shear: splat.shear,
            log2_opacity: splat.log2_opacity,
            rows: first as usize..end as usize,
            steps: first_step..end_step,
        }
    }

    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> Row {
        let dy = row as f32 + 0.5 - self.y;
        Row {
            dy,
            middle: self.x + self.shear * dy,
            log2_alpha: self.falloff[1] * dy * dy + self.log2_opacity,
            falloff: self.falloff[0],
        }
    }
}

impl Row {
    #[inline(always)]
    pub(super) fn touch<const FMA: bool>(&self, x: f32, limits: Limits) -> Touch {
        let dx = x - self.middle;
        let log2_alpha = mul_add::<FMA>(self.falloff * dx, dx, self.log2_alpha);
        let alpha = exp2::<FMA>(log2_alpha);
        Touch {
            dx,
            alpha: if alpha < limits.alpha_max { alpha } else { limits.alpha_max },
            is_seen: log2_alpha >= limits.log2_alpha_min,
            is_clamped: alpha > limits.alpha_max,
        }
    }
}

/// The top-left corner of a tile, pixels.
pub(super) fn origin(grid: Grid, tile: usize) -> [u32; 2] {
    [(tile % grid.columns * TILE) as u32, (tile / grid.columns * TILE) as u32]
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
    let origin = origin(lists.grid, index);
    let Tile { rgb, trace } = tile;
    let mut place = 0u32;
    let mut batch = [Splat::NONE; BATCH];
    for indices in lists.bins.pieces(index).flat_map(|piece| piece.chunks(BATCH)) {
        if trace.transmittance.iter().all(|&t| t <= 0.0) {
            return;
        }
        for splat in lists.splats.fetch(indices, &mut batch) {
            place += 1;
            if place == 1 {
                trace.nearest = splat.depth;
            }
            let local = Local::new::<L>(splat, origin);
            for y in local.rows.clone() {
                let row = local.row(y);
                for step in local.steps.clone() {
                    let at = y * TILE + step * L;
                    let centres = centres::<L>(step);
                    let mut weight = [0.0; L];
                    let transmittance = lanes::<_, L>(&mut trace.transmittance, at);
                    let last = lanes::<_, L>(&mut trace.last, at);
                    for lane in 0..L {
                        let touch = row.touch::<FMA>(centres[lane], limits);
                        let before = transmittance[lane];
                        let seen = touch.is_seen & (before > 0.0);
                        let stops = before * (1.0 - touch.alpha) < limits.transmittance_min;
                        weight[lane] = if seen & !stops { before * touch.alpha } else { 0.0 };
                        // A product, because the compiler turns a choice into a masked store, which is slow.
                        let factor = if stops { -1.0 } else { 1.0 - touch.alpha };
                        transmittance[lane] = before * if seen { factor } else { 1.0 };
                        if RECORD {
                            last[lane] = if seen & !stops { place } else { last[lane] };
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
}

/// The centres of the pixels of a step.
#[inline(always)]
pub(super) fn centres<const L: usize>(step: usize) -> [f32; L] {
    std::array::from_fn(|lane| (step * L + lane) as f32 + 0.5)
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
