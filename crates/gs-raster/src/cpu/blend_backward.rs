//! The blending of every tile backwards: from gradients by pixels to sums per splat.
//!
//! A pixel's splats are walked back to front, from the one before that at which it was done, with the numbers and decisions of the pass
//! forward. With w = α T and q = ∂L/∂w of each splat (its colour times the pixel's gradient, and what its depth does to
//! the expected depth), ∂L/∂α = T (q - B), where B is q of what is behind, blended as the colours are. T is divided by
//! 1 - α at each step, the very number it was multiplied by.

use super::bin::{Places, chunk_size};
use super::blend::{Lists, Trace};
use super::local::{Batch, Limits, Local};
use super::tile::{Buffer, LANES, PATCHES, Place, Plane, Strips, at, integers_at, origin, patch, put};
use super::{Grid, TILE};
use crate::gradients::{finite, largest_magnitude};
use crate::{PixelGradients, RenderSettings};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::vector::select;
use cpu_kernels::{compiled_for, dispatch};
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Sums over pixels of s = ∂L/∂log₂α, of its products with the distances (dx, dy) of [`Touch`](super::local::Touch), and of the gradients by
/// colour and z-depth: s, s dx, s dx², s dy, s dy², s dx dy, red, green, blue, depth. Then, of the splat's share w in a
/// pixel, Σ w and Σ w v with v the values to be weighted.
pub(super) type Moments = [f32; MOMENTS];
pub(super) const MOMENTS: usize = 12;
/// Where the sums of shares are among the moments.
pub(super) const SHARES: usize = 10;

/// Memory that is used from one pass to the next.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    /// Per tile, the moments of the splats of its list.
    by_tile: Vec<Moments>,
    by_splat: Vec<Moments>,
}

/// The sums of all splats.
pub(super) struct Summed<'a> {
    /// In the order of depth; but for shares, of the gradients by pixels times a power of two that makes them small: what is finite does
    /// not overflow on the way, and what is tiny keeps its digits.
    pub(super) moments: &'a [Moments],
    /// What they are to be multiplied by.
    pub(super) unit: f64,
    /// The gradient by the background.
    pub(super) background: [f64; 3],
}

/// Sums the gradients of each splat over its pixels. Shares are summed if there are `values`, one per pixel.
pub(super) fn sum<'a>(
    lists: Lists,
    settings: &RenderSettings,
    traces: &[Trace],
    (pixels, values): (&PixelGradients, Option<&[f32]>),
    Buffers { by_tile, by_splat }: &'a mut Buffers,
) -> Summed<'a> {
    let unit = unit(pixels);
    let limits = Limits::new(settings);
    let blend_tile = match (pixels.depth.is_some(), values.is_some()) {
        (false, false) => blend_tile::<false, false>,
        (false, true) => blend_tile::<false, true>,
        (true, false) => blend_tile::<true, false>,
        (true, true) => blend_tile::<true, true>,
    };
    let counts = (0..traces.len()).map(|index| lists.bins.len(index));
    let mut rest = entries(by_tile, counts.clone().sum());
    let tiles: Vec<(&mut [Moments], &Trace)> = counts
        .zip(traces)
        .map(|(count, trace)| {
            let (moments, after) = std::mem::take(&mut rest).split_at_mut(count);
            rest = after;
            (moments, trace)
        })
        .collect();
    let tiles: Vec<(&[Moments], [f64; 3])> = tiles
        .into_par_iter()
        .enumerate()
        .map(|(index, (moments, trace))| {
            let mut tile = Tile::new(lists.grid, index, trace, (pixels, values), settings, unit);
            blend_tile(&mut tile, &trace.strips, moments, (lists, index), limits);
            (&*moments, tile.background)
        })
        .collect();
    let mut background = [0.0; 3];
    for (_, tile) in &tiles {
        for (sum, value) in background.iter_mut().zip(tile) {
            *sum += unit * value;
        }
    }
    // Each splat's tiles in the order in which they are listed, whoever sums them.
    let places = lists.bins.places();
    let moments = entries(by_splat, places.iter().map(Places::len).sum());
    moments.par_chunks_mut(chunk_size(lists.grid)).zip(places).for_each(|(moments, places)| {
        let mut moments = moments.iter_mut();
        let mut rows: Vec<Moments> = Vec::new();
        places.for_each_batch(|places, of_splat| {
            // They lie far apart in memory: all are read before the first is summed, so that the waits for them overlap.
            rows.clear();
            rows.extend(places.iter().map(|&(tile, place)| tiles[tile].0[place]));
            compiled_for!(lists.isa, {
                let mut rows = rows.iter();
                for (&count, moments) in of_splat.iter().zip(moments.by_ref()) {
                    let mut sum = [0.0; MOMENTS];
                    for row in rows.by_ref().take(count as usize) {
                        for (sum, &value) in sum.iter_mut().zip(row) {
                            *sum += f64::from(value);
                        }
                    }
                    *moments = sum.map(finite);
                }
            });
        });
    });
    Summed { moments, unit, background }
}

/// As many entries of a buffer, which may hold anything. A buffer that is far too large is given back, so that one large view does not hold
/// its memory for ever.
fn entries(buffer: &mut Vec<Moments>, count: usize) -> &mut [Moments] {
    const FAR_TOO_LARGE: usize = 4;
    if buffer.len() < count || buffer.len() / FAR_TOO_LARGE > count {
        // First the one, then the other: not both at a time.
        *buffer = Vec::new();
        *buffer = vec![[0.0; MOMENTS]; count];
    }
    &mut buffer[..count]
}

/// The power of two in which gradients by pixels are at most 2⁻²³.
fn unit(pixels: &PixelGradients) -> f64 {
    let planes = [Some(&*pixels.image), pixels.alpha.as_deref(), pixels.depth.as_deref()];
    let largest = planes.into_iter().flatten().map(largest_magnitude).fold(0.0, f32::max);
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
    /// The values that are weighted by shares.
    values: Plane,
    /// Expected depth, from `nearest`.
    expected: Plane,
    nearest: f32,
    /// What is left of the light from behind, after the splats that are still to come.
    transmittance: Plane,
    /// B: what is behind, blended as if nothing stood before it.
    behind: Plane,
    /// As in [`Trace`].
    done: Plane<i32>,
    /// Σ gradient by colour times what shows of the background.
    background: [f64; 3],
}

impl Tile {
    fn new(
        grid: Grid,
        index: usize,
        trace: &Trace,
        (pixels, values): (&PixelGradients, Option<&[f32]>),
        settings: &RenderSettings,
        unit: f64,
    ) -> Box<Self> {
        let mut tile = Box::new(Self {
            rgb: [[[0.0; LANES]; PATCHES]; 3],
            depth: [[0.0; LANES]; PATCHES],
            values: [[0.0; LANES]; PATCHES],
            expected: [[0.0; LANES]; PATCHES],
            nearest: trace.nearest,
            transmittance: trace.transmittance.map(|patch| patch.map(f32::abs)),
            behind: [[0.0; LANES]; PATCHES],
            done: trace.done,
            background: [0.0; 3],
        });
        let inverse = unit.recip();
        let scaled = |value: f32| (f64::from(value) * inverse) as f32;
        let (column, row) = (index % grid.columns * TILE, index / grid.columns * TILE);
        for y in row..grid.height.min(row + TILE) {
            for x in column..grid.width.min(column + TILE) {
                let ((patch, lane), pixel) = (patch(x - column, y - row), y * grid.width + x);
                let transmittance = tile.transmittance[patch][lane];
                let mut behind = 0.0;
                for channel in 0..3 {
                    let gradient = scaled(pixels.image[pixel * 3 + channel]);
                    tile.rgb[channel][patch][lane] = gradient;
                    behind += gradient * settings.background[channel];
                    tile.background[channel] += f64::from(gradient) * f64::from(transmittance);
                }
                if let Some(alpha) = &pixels.alpha {
                    behind -= scaled(alpha[pixel]);
                }
                tile.behind[patch][lane] = behind;
                if let Some(values) = values {
                    tile.values[patch][lane] = values[pixel];
                }
                if let Some(depth) = &pixels.depth
                    && trace.weight[patch][lane] > 0.0
                {
                    tile.depth[patch][lane] = scaled(depth[pixel]) / trace.weight[patch][lane];
                    tile.expected[patch][lane] = trace.depth[patch][lane] / trace.weight[patch][lane];
                }
            }
        }
        tile
    }
}

/// The moments of the splats of tile number `index`, in the order of its list; `strips` are those of its [`Trace`].
fn blend_tile<const DEPTH: bool, const SHARED: bool>(
    tile: &mut Tile,
    strips: &[Strips],
    moments: &mut [Moments],
    (lists, index): (Lists, usize),
    limits: Limits,
) {
    dispatch(lists.isa, Blend::<DEPTH, SHARED> { tile, strips, moments, lists, index, limits });
}

struct Blend<'a, const DEPTH: bool, const SHARED: bool> {
    tile: &'a mut Tile,
    strips: &'a [Strips],
    moments: &'a mut [Moments],
    lists: Lists<'a>,
    index: usize,
    limits: Limits,
}

impl<const DEPTH: bool, const SHARED: bool> WithSimd for Blend<'_, DEPTH, SHARED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, strips, moments, lists, index, limits } = self;
        let origin = origin(lists.grid, index);
        let mut batch = Batch::EMPTY;
        // What follows on the last splat that may be drawn has no moments.
        let (moments, none) = moments.split_at_mut(strips.len());
        none.fill([0.0; MOMENTS]);
        let mut indices = lists.bins.pieces(index).flatten().rev().skip(none.len());
        let mut rest = strips.iter().zip(moments).enumerate().rev();
        let (mut alphas, mut dxs) = (Buffer::EMPTY, Buffer::EMPTY);
        let (alphas, dxs) = (alphas.vectors::<S>(), dxs.vectors::<S>());
        while rest.len() > 0 {
            batch.fetch(lists.splats, &mut indices, origin);
            for (splat, (before, (strips, moments))) in batch.splats().iter().zip(&mut rest) {
                strips.for_each::<S>(
                    #[inline(always)]
                    |k, place| {
                        let touch = splat.touch(simd, place, limits);
                        let done = integers_at::<S>(&tile.done, place);
                        let is_lit = simd.greater_than_i32s(done, simd.splat_i32s(before as i32 + 1));
                        let drawn = simd.and_m32s(touch.is_seen, is_lit);
                        alphas[k] = select(simd, drawn, touch.alpha, simd.splat_f32s(0.0));
                        dxs[k] = touch.dx;
                    },
                );
                let mut found = [simd.splat_f32s(0.0); MOMENTS];
                strips.for_each::<S>(
                    #[inline(always)]
                    |k, place| {
                        let touch = (alphas[k], dxs[k], splat.dy(simd, place));
                        blend_vector::<S, DEPTH, SHARED>(simd, tile, splat, place, touch, limits, &mut found);
                    },
                );
                *moments = [0.0; MOMENTS];
                for k in summed::<DEPTH, SHARED>() {
                    moments[k] = simd.reduce_sum_f32s(found[k]);
                }
            }
        }
    }
}

/// Which moments are asked for.
#[inline(always)]
fn summed<const DEPTH: bool, const SHARED: bool>() -> impl Iterator<Item = usize> {
    (0..MOMENTS).filter(|&k| if k >= SHARES { SHARED } else { k < 9 || DEPTH })
}

/// Takes a splat from a vector of pixels, and adds what its gradients are there.
#[inline(always)]
fn blend_vector<S: Simd, const DEPTH: bool, const SHARED: bool>(
    simd: S,
    tile: &mut Tile,
    splat: &Local,
    place: Place,
    (alpha, dx, dy): (S::f32s, S::f32s, S::f32s),
    limits: Limits,
    found: &mut [S::f32s; MOMENTS],
) {
    let all = |v: f32| simd.splat_f32s(v);
    // Where the splat is not drawn its share is 0, and nothing changes: no select of what is stored, which would be a masked store.
    let share = simd.min_f32s(alpha, all(limits.alpha_max));
    let after = at::<S>(&tile.transmittance, place);
    let before = simd.div_f32s(after, simd.sub_f32s(all(1.0), share));
    put::<S>(&mut tile.transmittance, place, before);
    let weight = simd.mul_f32s(before, share);
    if SHARED {
        found[10] = simd.add_f32s(found[10], weight);
        found[11] = simd.mul_add_e_f32s(weight, at::<S>(&tile.values, place), found[11]);
    }
    let rgb = [0, 1, 2].map(|channel| at::<S>(&tile.rgb[channel], place));
    for (sum, gradient) in found[6..9].iter_mut().zip(rgb) {
        *sum = simd.mul_add_e_f32s(weight, gradient, *sum);
    }
    let mut q = simd.mul_f32s(rgb[0], all(splat.rgb[0]));
    q = simd.mul_add_e_f32s(rgb[1], all(splat.rgb[1]), q);
    q = simd.mul_add_e_f32s(rgb[2], all(splat.rgb[2]), q);
    if DEPTH {
        let depth = at::<S>(&tile.depth, place);
        found[9] = simd.mul_add_e_f32s(weight, depth, found[9]);
        let from_expected = simd.sub_f32s(all(splat.depth - tile.nearest), at::<S>(&tile.expected, place));
        q = simd.mul_add_e_f32s(depth, from_expected, q);
    }
    let behind = at::<S>(&tile.behind, place);
    let nearer = simd.sub_f32s(q, behind);
    put::<S>(&mut tile.behind, place, simd.mul_add_e_f32s(share, nearer, behind));

    // A clamped opacity does not follow the splat.
    let clamped = simd.greater_than_f32s(alpha, all(limits.alpha_max));
    let slope = select(simd, clamped, all(0.0), simd.mul_f32s(all(LN_2), weight));
    let s = simd.mul_f32s(slope, nearer);
    let (s_dx, s_dy) = (simd.mul_f32s(s, dx), simd.mul_f32s(s, dy));
    found[0] = simd.add_f32s(found[0], s);
    found[1] = simd.add_f32s(found[1], s_dx);
    found[2] = simd.mul_add_e_f32s(s_dx, dx, found[2]);
    found[3] = simd.add_f32s(found[3], s_dy);
    found[4] = simd.mul_add_e_f32s(s_dy, dy, found[4]);
    found[5] = simd.mul_add_e_f32s(s_dx, dy, found[5]);
}
