//! Near-to-far compositing of a tile's splats, a patch of 4×4 pixels at a time: of most splats it takes fewer patches
//! than rows to cover them.
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
                    let (tile, at) = (&tiles[x / TILE], y * grid.width + x);
                    let (patch, lane) = patch(x % TILE, y);
                    let transmittance = tile.trace.transmittance[patch][lane].abs();
                    *alpha = 1.0 - transmittance;
                    for channel in 0..3 {
                        image[at * 3 + channel] =
                            tile.rgb[channel][patch][lane] + transmittance * settings.background[channel];
                    }
                    let weight = tile.trace.weight[patch][lane];
                    if let Some(depth) = depth.get_mut(at).filter(|_| weight > 0.0) {
                        *depth = tile.trace.nearest + tile.trace.depth[patch][lane] / weight;
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
            rgb: [[[0.0; LANES]; PATCHES]; 3],
            trace: Trace {
                transmittance: [[-1.0; LANES]; PATCHES],
                last: [[0; LANES]; PATCHES],
                weight: [[0.0; LANES]; PATCHES],
                depth: [[0.0; LANES]; PATCHES],
                nearest: 0.0,
            },
        });
        for y in 0..TILE.min(grid.height - row * TILE) {
            for x in 0..TILE.min(grid.width - column * TILE) {
                let (patch, lane) = patch(x, y);
                tile.trace.transmittance[patch][lane] = 1.0;
            }
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
    /// Rows and columns of patches that the ellipse may touch.
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
}

/// A splat in a row of patches.
pub(super) struct Row {
    /// Distance of the pixels from the centre, pixels.
    pub(super) dy: [f32; LANES],
    /// The middle of the ellipse's row through the pixels.
    middle: [f32; LANES],
    /// log₂ of the opacity there.
    log2_alpha: [f32; LANES],
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
            rows: first / SIDE..last / SIDE + 1,
            columns: left / SIDE..right.div_ceil(SIDE),
        }
    }

    #[inline(always)]
    pub(super) fn row(&self, row: usize) -> Row {
        let mut found = Row {
            dy: [0.0; LANES],
            middle: [0.0; LANES],
            log2_alpha: [0.0; LANES],
            falloff: self.falloff[0],
        };
        for lane in 0..LANES {
            let dy = (row * SIDE + lane / SIDE) as f32 + 0.5 - self.y;
            found.dy[lane] = dy;
            found.middle[lane] = self.x + self.shear * dy;
            found.log2_alpha[lane] = self.falloff[1] * dy * dy + self.log2_opacity;
        }
        found
    }
}

impl Row {
    #[inline(always)]
    pub(super) fn touch<const FMA: bool>(&self, column: usize, lane: usize, limits: Limits) -> Touch {
        let dx = (column * SIDE + lane % SIDE) as f32 + 0.5 - self.middle[lane];
        let log2_alpha = mul_add::<FMA>(self.falloff * dx, dx, self.log2_alpha[lane]);
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
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        blend_tile_with::<DEPTH, RECORD, true>(tile, lists, index, limits);
    } else {
        blend_tile_with::<DEPTH, RECORD, false>(tile, lists, index, limits);
    }
}

#[inline(always)]
fn blend_tile_with<const DEPTH: bool, const RECORD: bool, const FMA: bool>(
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
                let row = local.row(y);
                for x in local.columns.clone() {
                    let patch = y * SIDE + x;
                    let mut weight = [0.0; LANES];
                    let transmittance = &mut trace.transmittance[patch];
                    let last = &mut trace.last[patch];
                    for lane in 0..LANES {
                        let touch = row.touch::<FMA>(x, lane, limits);
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
                        accumulate::<FMA>(&mut channel[patch], &weight, colour);
                    }
                    if DEPTH {
                        accumulate::<FMA>(&mut trace.weight[patch], &weight, 1.0);
                        let depth = splat.depth - trace.nearest;
                        accumulate::<FMA>(&mut trace.depth[patch], &weight, depth);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn accumulate<const FMA: bool>(sum: &mut [f32; LANES], weight: &[f32; LANES], value: f32) {
    for (sum, weight) in sum.iter_mut().zip(weight) {
        *sum = mul_add::<FMA>(*weight, value, *sum);
    }
}
