//! The blending of every tile backwards: from gradients by pixels to sums per splat.
//!
//! A pixel's splats are walked back to front, from the one before that at which it was done, with the numbers and decisions of the pass
//! forward. With w = α T and q = ∂L/∂w of each splat (its colour times the pixel's gradient, and what its depth does to
//! the expected depth), ∂L/∂α = T (q - B), where B is q of what is behind, blended as the colours are. T is divided by
//! 1 - α at each step, the very number it was multiplied by.

use super::bin::{Places, chunk_size};
use super::blend::{
    LANES, Limits, Lists, Local, PATCHES, Plane, Row, SIDE, Trace, any, origin, patch, vectors, vectors_mut,
};
use super::project::{BATCH, Splat};
use super::{Grid, TILE};
use crate::gradients::{finite, largest_magnitude};
use crate::{PixelGradients, RenderSettings};
use cpu_kernels::dispatch;
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::vector::select;
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Sums over pixels of s = ∂L/∂log₂α, of its products with the distances (dx, dy) of [`Touch`](super::blend::Touch), and of the gradients by
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
            moments.fill([0.0; MOMENTS]);
            blend_tile(&mut tile, moments, lists, index, limits);
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
    /// Both as in [`Trace`].
    done: Plane<i32>,
    last: i32,
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
            last: trace.last,
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

/// The moments of the splats of tile number `index`, in the order of its list.
fn blend_tile<const DEPTH: bool, const SHARED: bool>(
    tile: &mut Tile,
    moments: &mut [Moments],
    lists: Lists,
    index: usize,
    limits: Limits,
) {
    dispatch(lists.isa, Blend::<DEPTH, SHARED> { tile, moments, lists, index, limits });
}

struct Blend<'a, const DEPTH: bool, const SHARED: bool> {
    tile: &'a mut Tile,
    moments: &'a mut [Moments],
    lists: Lists<'a>,
    index: usize,
    limits: Limits,
}

impl<const DEPTH: bool, const SHARED: bool> WithSimd for Blend<'_, DEPTH, SHARED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, moments, lists, index, limits } = self;
        let origin = origin(lists.grid, index);
        let mut place = moments.len() as i32 + 1;
        let mut batch = [Splat::NONE; BATCH];
        for indices in lists.bins.pieces(index).rev().flat_map(|piece| piece.rchunks(BATCH)) {
            if place - indices.len() as i32 > tile.last {
                place -= indices.len() as i32;
                continue;
            }
            for splat in lists.splats.fetch(indices, &mut batch).iter().rev() {
                place -= 1;
                if place > tile.last {
                    continue;
                }
                let local = Local::new(splat, origin);
                let zero = simd.splat_f32s(0.0);
                let mut found = [zero; MOMENTS];
                for y in local.rows.clone() {
                    for v in 0..LANES / S::F32_LANES {
                        if let Some(row) = local.row(simd, y, v) {
                            let mut sums = Sums::<S> { s: [zero; 3], weight: [zero; 6] };
                            for x in local.columns.clone() {
                                let target = Place { patch: (y * SIDE + x) % PATCHES, v, x, place };
                                blend_vector::<S, DEPTH, SHARED>(
                                    simd, tile, splat, target, &row, limits, &mut sums,
                                );
                            }
                            sums.add_to::<DEPTH, SHARED>(simd, row.dy, &mut found);
                        }
                    }
                }
                let moments = &mut moments[place as usize - 1];
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

/// Which patch of a tile and vector of the patch, in which column of patches, and which splat of the tile, counted from 1.
#[derive(Clone, Copy)]
struct Place {
    patch: usize,
    v: usize,
    x: usize,
    place: i32,
}

/// Sums of a splat over the patches of a row: s, s dx, s dx²; and of its share the products with the gradients by colour and
/// depth, the share itself and its product with the values. Along a row dy is the
/// same, so that its products are made at the end.
struct Sums<S: Simd> {
    s: [S::f32s; 3],
    weight: [S::f32s; 6],
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    fn add_to<const DEPTH: bool, const SHARED: bool>(
        self,
        simd: S,
        dy: S::f32s,
        found: &mut [S::f32s; MOMENTS],
    ) {
        let [s, s_dx, s_dxdx] = self.s;
        let s_dy = simd.mul_f32s(s, dy);
        found[0] = simd.add_f32s(found[0], s);
        found[1] = simd.add_f32s(found[1], s_dx);
        found[2] = simd.add_f32s(found[2], s_dxdx);
        found[3] = simd.add_f32s(found[3], s_dy);
        found[4] = simd.mul_add_e_f32s(s_dy, dy, found[4]);
        found[5] = simd.mul_add_e_f32s(s_dx, dy, found[5]);
        for k in summed::<DEPTH, SHARED>().filter(|&k| k >= 6) {
            found[k] = simd.add_f32s(found[k], self.weight[k - 6]);
        }
    }
}

/// Takes a splat from a vector of pixels, and adds what its gradients are there.
#[inline(always)]
fn blend_vector<S: Simd, const DEPTH: bool, const SHARED: bool>(
    simd: S,
    tile: &mut Tile,
    splat: &Splat,
    Place { patch, v, x, place }: Place,
    row: &Row<S>,
    limits: Limits,
    sums: &mut Sums<S>,
) {
    let number = |v: f32| simd.splat_f32s(v);
    let touch = row.touch(simd, x, limits);
    let done = S::as_simd_i32s(&tile.done[patch]).0[v];
    let drawn = simd.and_m32s(touch.is_seen, simd.greater_than_i32s(done, simd.splat_i32s(place)));
    if !any(simd, drawn) {
        return;
    }
    // What is needed last is made first, of as few vectors as there are: AVX2 has sixteen.
    let (unclamped, alpha) = touch.alpha(simd, limits);
    // A clamped opacity does not follow the splat.
    let clamped = simd.greater_than_f32s(unclamped, number(limits.alpha_max));
    let follows = simd.and_m32s(drawn, simd.not_m32s(clamped));
    // Where the splat is not drawn its share is 0, and nothing changes: no select of what is stored, which would be a masked store.
    let share = select(simd, drawn, alpha, number(0.0));
    let transmittance = &mut vectors_mut::<S>(&mut tile.transmittance[patch])[v];
    let before = simd.div_f32s(*transmittance, simd.sub_f32s(number(1.0), share));
    *transmittance = before;
    let slope = simd.mul_f32s(simd.mul_f32s(number(LN_2), share), before);
    let weight = simd.mul_f32s(before, share);

    if SHARED {
        let value = vectors::<S>(&tile.values[patch])[v];
        sums.weight[4] = simd.add_f32s(sums.weight[4], weight);
        sums.weight[5] = simd.mul_add_e_f32s(weight, value, sums.weight[5]);
    }
    let rgb = [0, 1, 2].map(|channel| vectors::<S>(&tile.rgb[channel][patch])[v]);
    for (sum, gradient) in sums.weight.iter_mut().zip(rgb) {
        *sum = simd.mul_add_e_f32s(weight, gradient, *sum);
    }
    let mut q = simd.mul_f32s(rgb[0], number(splat.rgb[0]));
    q = simd.mul_add_e_f32s(rgb[1], number(splat.rgb[1]), q);
    q = simd.mul_add_e_f32s(rgb[2], number(splat.rgb[2]), q);
    if DEPTH {
        let depth = vectors::<S>(&tile.depth[patch])[v];
        sums.weight[3] = simd.mul_add_e_f32s(weight, depth, sums.weight[3]);
        let expected = vectors::<S>(&tile.expected[patch])[v];
        let from_expected = simd.sub_f32s(number(splat.depth - tile.nearest), expected);
        q = simd.mul_add_e_f32s(depth, from_expected, q);
    }
    let behind = &mut vectors_mut::<S>(&mut tile.behind[patch])[v];
    let nearer = simd.sub_f32s(q, *behind);
    *behind = simd.mul_add_e_f32s(share, nearer, *behind);

    let s = select(simd, follows, simd.mul_f32s(slope, nearer), number(0.0));
    let s_dx = simd.mul_f32s(s, touch.dx);
    sums.s[0] = simd.add_f32s(sums.s[0], s);
    sums.s[1] = simd.add_f32s(sums.s[1], s_dx);
    sums.s[2] = simd.mul_add_e_f32s(s_dx, touch.dx, sums.s[2]);
}
