//! The blending of every tile backwards: from gradients by pixels to sums per splat.
//!
//! A pixel's splats are walked back to front from the last that was drawn, with the numbers and decisions of the pass
//! forward. With w = α T and q = ∂L/∂w of each splat (its colour times the pixel's gradient, and what its depth does to
//! the expected depth), ∂L/∂α = T (q - B), where B is q of what is behind, blended as the colours are. T is divided by
//! 1 - α at each step, the very number it was multiplied by.

use super::bin::{Places, chunk_size};
use super::blend::{LANES, Limits, Lists, Local, PATCHES, Plane, SIDE, Trace, origin, patch};
use super::math::mul_add;
use super::project::{BATCH, Splat};
use super::{Grid, TILE};
use crate::{PixelGradients, RenderSettings};
use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Sums over pixels of s = ∂L/∂log₂α, of its products with the distances (dx, dy) of [`Touch`](super::blend::Touch), and of the gradients by
/// colour and z-depth: s, s dx, s dx², s dy, s dy², s dx dy, red, green, blue, depth.
pub(super) type Moments = [f32; MOMENTS];
pub(super) const MOMENTS: usize = 10;

/// The sums of all splats.
pub(super) struct Summed {
    /// In the order of depth, of the gradients by pixels times a power of two that makes them small: what is finite does
    /// not overflow on the way, and what is tiny keeps its digits.
    pub(super) moments: Vec<Moments>,
    /// What they are to be multiplied by.
    pub(super) unit: f64,
}

/// Sums the gradients of each splat over its pixels, and adds the gradient by the background to `background`.
pub(super) fn sum(
    lists: Lists,
    settings: &RenderSettings,
    traces: &[Trace],
    pixels: &PixelGradients,
    background: &mut [f64; 3],
) -> Summed {
    let unit = unit(pixels);
    let limits = Limits::new(settings);
    let blend_tile = if pixels.depth.is_some() { blend_tile::<true> } else { blend_tile::<false> };
    let tiles: Vec<(Vec<Moments>, [f64; 3])> = traces
        .par_iter()
        .enumerate()
        .map(|(index, trace)| {
            let mut tile = Tile::new(lists.grid, index, trace, pixels, settings, unit);
            let mut moments = vec![[0.0; MOMENTS]; lists.bins.len(index)];
            blend_tile(&mut tile, &mut moments, lists, index, limits);
            (moments, tile.background)
        })
        .collect();
    for (_, tile) in &tiles {
        for (sum, value) in background.iter_mut().zip(tile) {
            *sum += unit * value;
        }
    }
    // Each splat's tiles in the order in which they are listed, whoever sums them.
    let places = lists.bins.places();
    let mut moments = vec![[0.0; MOMENTS]; places.iter().map(Places::len).sum()];
    moments.par_chunks_mut(chunk_size(lists.grid)).zip(places).for_each(|(moments, places)| {
        let mut moments = moments.iter_mut();
        places.for_each(|places| {
            let mut sum = [0.0; MOMENTS];
            for &(tile, place) in places {
                for (sum, &value) in sum.iter_mut().zip(&tiles[tile].0[place]) {
                    *sum += f64::from(value);
                }
            }
            if let Some(moments) = moments.next() {
                *moments = sum.map(finite);
            }
        });
    });
    Summed { moments, unit }
}

/// A number as f32: at most the largest there is, and 0 for what is none.
#[inline(always)]
pub(super) fn finite(value: f64) -> f32 {
    if value.is_nan() { 0.0 } else { value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32 }
}

/// The power of two in which gradients by pixels are at most 2⁻²³.
fn unit(pixels: &PixelGradients) -> f64 {
    let planes = [Some(&pixels.image), pixels.alpha.as_ref(), pixels.depth.as_ref()];
    let largest =
        planes.into_iter().flatten().flatten().fold(0.0f32, |largest, value| largest.max(value.abs()));
    // 2^e ≤ largest < 2^(e+1), where f64 has no denormals that f32 could reach.
    let exponent = if largest > 0.0 { (f64::from(largest).to_bits() >> 52) as i32 - 1023 } else { 0 };
    f64::from(exponent + 24).exp2()
}

/// The pixels of a tile on the way back.
#[repr(align(64))]
struct Tile {
    /// The gradients by colour and, divided by Σ w, by expected depth.
    rgb: [Plane; 3],
    depth: Plane,
    /// Expected depth, from `nearest`.
    expected: Plane,
    nearest: f32,
    /// What is left of the light from behind, after the splats that are still to come.
    transmittance: Plane,
    /// B: what is behind, blended as if nothing stood before it.
    behind: Plane,
    /// As in [`Trace`].
    last: Plane<u32>,
    /// Σ gradient by colour times what shows of the background.
    background: [f64; 3],
}

impl Tile {
    fn new(
        grid: Grid,
        index: usize,
        trace: &Trace,
        pixels: &PixelGradients,
        settings: &RenderSettings,
        unit: f64,
    ) -> Box<Self> {
        let mut tile = Box::new(Self {
            rgb: [[[0.0; LANES]; PATCHES]; 3],
            depth: [[0.0; LANES]; PATCHES],
            expected: [[0.0; LANES]; PATCHES],
            nearest: trace.nearest,
            transmittance: trace.transmittance.map(|patch| patch.map(f32::abs)),
            behind: [[0.0; LANES]; PATCHES],
            last: trace.last,
            background: [0.0; 3],
        });
        let inverse = unit.recip();
        let scaled = |value: f32| (f64::from(value) * inverse) as f32;
        let (column, row) = (index % grid.columns * TILE, index / grid.columns * TILE);
        for y in row..grid.height.min(row + TILE) {
            for x in column..grid.width.min(column + TILE) {
                let ((patch, lane), at) = (patch(x - column, y - row), y * grid.width + x);
                let transmittance = tile.transmittance[patch][lane];
                let mut behind = 0.0;
                for channel in 0..3 {
                    let gradient = scaled(pixels.image[at * 3 + channel]);
                    tile.rgb[channel][patch][lane] = gradient;
                    behind += gradient * settings.background[channel];
                    tile.background[channel] += f64::from(gradient) * f64::from(transmittance);
                }
                if let Some(alpha) = &pixels.alpha {
                    behind -= scaled(alpha[at]);
                }
                tile.behind[patch][lane] = behind;
                if let Some(depth) = &pixels.depth
                    && trace.weight[patch][lane] > 0.0
                {
                    tile.depth[patch][lane] = scaled(depth[at]) / trace.weight[patch][lane];
                    tile.expected[patch][lane] = trace.depth[patch][lane] / trace.weight[patch][lane];
                }
            }
        }
        tile
    }
}

/// The moments of the splats of tile number `index`, in the order of its list.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn blend_tile<const DEPTH: bool>(
    tile: &mut Tile,
    moments: &mut [Moments],
    lists: Lists,
    index: usize,
    limits: Limits,
) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        blend_tile_with::<DEPTH, true>(tile, moments, lists, index, limits);
    } else {
        blend_tile_with::<DEPTH, false>(tile, moments, lists, index, limits);
    }
}

#[inline(always)]
fn blend_tile_with<const DEPTH: bool, const FMA: bool>(
    tile: &mut Tile,
    moments: &mut [Moments],
    lists: Lists,
    index: usize,
    limits: Limits,
) {
    let origin = origin(lists.grid, index);
    let deepest = tile.last.iter().flatten().copied().fold(0, u32::max);
    let mut place = moments.len() as u32 + 1;
    let mut batch = [Splat::NONE; BATCH];
    for indices in lists.bins.pieces(index).rev().flat_map(|piece| piece.rchunks(BATCH)) {
        if place - indices.len() as u32 > deepest {
            place -= indices.len() as u32;
            continue;
        }
        for splat in lists.splats.fetch(indices, &mut batch).iter().rev() {
            place -= 1;
            if place > deepest {
                continue;
            }
            let local = Local::new(splat, origin);
            let mut sums = [[0.0; LANES]; MOMENTS];
            for y in local.rows.clone() {
                let row = local.row(y);
                for x in local.columns.clone() {
                    let patch = y * SIDE + x;
                    let rgb = [&tile.rgb[0][patch], &tile.rgb[1][patch], &tile.rgb[2][patch]];
                    let (depth, expected) = (&tile.depth[patch], &tile.expected[patch]);
                    let last = &tile.last[patch];
                    let transmittance = &mut tile.transmittance[patch];
                    let behind = &mut tile.behind[patch];
                    for lane in 0..LANES {
                        let touch = row.touch::<FMA>(x, lane, limits);
                        let drawn = touch.is_seen & (place <= last[lane]);
                        let alpha = touch.alpha;
                        let before = transmittance[lane] / (1.0 - alpha);
                        let weight = if drawn { before * alpha } else { 0.0 };
                        let mut q = rgb[0][lane] * splat.rgb[0];
                        q = mul_add::<FMA>(rgb[1][lane], splat.rgb[1], q);
                        q = mul_add::<FMA>(rgb[2][lane], splat.rgb[2], q);
                        if DEPTH {
                            q = mul_add::<FMA>(depth[lane], splat.depth - tile.nearest - expected[lane], q);
                        }
                        let nearer = q - behind[lane];
                        let follows = drawn & !touch.is_clamped;
                        let s = if follows { LN_2 * alpha * before * nearer } else { 0.0 };
                        behind[lane] = mul_add::<FMA>(if drawn { alpha } else { 0.0 }, nearer, behind[lane]);
                        transmittance[lane] = if drawn { before } else { transmittance[lane] };

                        let (dx, dy) = (touch.dx, row.dy[lane]);
                        let (s_dx, s_dy) = (s * dx, s * dy);
                        sums[0][lane] += s;
                        sums[1][lane] += s_dx;
                        sums[2][lane] = mul_add::<FMA>(s_dx, dx, sums[2][lane]);
                        sums[3][lane] += s_dy;
                        sums[4][lane] = mul_add::<FMA>(s_dy, dy, sums[4][lane]);
                        sums[5][lane] = mul_add::<FMA>(s_dx, dy, sums[5][lane]);
                        for channel in 0..3 {
                            sums[6 + channel][lane] =
                                mul_add::<FMA>(weight, rgb[channel][lane], sums[6 + channel][lane]);
                        }
                        if DEPTH {
                            sums[9][lane] = mul_add::<FMA>(weight, depth[lane], sums[9][lane]);
                        }
                    }
                }
            }
            for (moment, lanes) in moments[place as usize - 1].iter_mut().zip(sums) {
                *moment = total(lanes);
            }
        }
    }
}

/// The sum of all lanes, in pairs.
#[inline(always)]
fn total(mut lanes: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
        half /= 2;
    }
    lanes[0]
}
