//! The matching cost: zero-mean normalised cross-correlation (ZNCC) of 7×7 windows, the best of several sources.
//!
//! A picture is matched strip by strip. Rows of a source are warped into the reference one after the other; sums over seven
//! rows run along, so that a row costs the same whatever the height of the window.

mod hypotheses;

use crate::pair::Pair;
use crate::sgm;
use crate::texture::{Depths, Sampler, TOGETHER, Texture, splat};
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::vector::select;
use cpu_kernels::{Isa, compiled_for, dispatch};
pub(crate) use hypotheses::Hypotheses;
use hypotheses::Hypothesis;
use rayon::prelude::*;
use std::ops::Range;

/// Half the window: 7×7 pixels.
const RADIUS: usize = 3;
/// Rows and columns of the window.
const SIDE: usize = 2 * RADIUS + 1;
const WINDOW: f32 = (SIDE * SIDE) as f32;
/// Added to both variances (8-bit levels²): noise of a flat patch must not correlate.
const NOISE_VARIANCE: f32 = 2.0;
/// Cost where the point lies outside a source.
const OUTSIDE_COST: f32 = 0.75;
/// Rows per task: the buffers of a strip stay in the second-level cache, and sums that run along its rows keep their digits.
const STRIP: usize = 32;
/// Lanes of the widest vectors: rows are filled up to a multiple, so that vectors have no rest.
pub(crate) const LANES: usize = 16;
/// Costs 0..1 are stored as 0..`COST_LEVELS`: as fine as sums of eight paths, each with the price of a jump, leave room for in 16 bits.
pub(crate) const COST_LEVELS: f32 = 4000.0;
/// Stored cost beyond all others.
const BEYOND: u16 = 5000;

/// Window statistics of a reference view.
#[derive(Debug)]
pub(crate) struct WindowStatistics {
    mean: Vec<f32>,
    inverse_deviation: Vec<f32>,
}

/// Row `y` of the window sums starts with row `y - 3` of the picture, clamped.
fn clamped(y: usize, offset: usize, height: usize) -> usize {
    (y + offset).saturating_sub(RADIUS).min(height - 1)
}

/// Repeats the first and last of `n` column sums into the margins on both sides.
#[inline(always)]
fn extend_margins(columns: &mut [f32], n: usize) {
    let (first, last) = (columns[RADIUS], columns[RADIUS + n - 1]);
    columns[..RADIUS].fill(first);
    columns[RADIUS + n..][..RADIUS].fill(last);
}

impl WindowStatistics {
    pub(crate) fn new(texture: &Texture) -> Self {
        let (width, height) = (texture.width, texture.height);
        let mut mean = vec![0.0; width * height];
        let mut inverse_deviation = vec![0.0; width * height];
        let rows = mean.par_chunks_mut(width).zip(inverse_deviation.par_chunks_mut(width)).enumerate();
        rows.for_each(|(y, (mean, inverse_deviation))| {
            let mut sums = vec![0.0; width + 2 * RADIUS];
            let mut squares = sums.clone();
            for offset in 0..SIDE {
                let row = &texture.values[clamped(y, offset, height) * width..][..width];
                for (x, &v) in row.iter().enumerate() {
                    sums[RADIUS + x] += v;
                    squares[RADIUS + x] += v * v;
                }
            }
            extend_margins(&mut sums, width);
            extend_margins(&mut squares, width);
            for x in 0..width {
                mean[x] = sums[x..][..SIDE].iter().sum::<f32>() / WINDOW;
                let variance =
                    (squares[x..][..SIDE].iter().sum::<f32>() / WINDOW - mean[x] * mean[x]).max(0.0);
                inverse_deviation[x] = 1.0 / (variance + NOISE_VARIANCE).sqrt();
            }
        });
        Self { mean, inverse_deviation }
    }

    /// Standard deviation of the luma in the window around a pixel, 8-bit levels.
    pub(crate) fn deviation(&self, pixel: usize) -> f32 {
        (self.inverse_deviation[pixel].powi(-2) - NOISE_VARIANCE).max(0.0).sqrt()
    }
}

/// The view whose pixels are matched.
#[derive(Clone, Copy)]
pub(crate) struct Reference<'a> {
    pub(crate) texture: &'a Texture,
    pub(crate) statistics: &'a WindowStatistics,
}

/// A view that it is matched with.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) texture: &'a Texture,
    pub(crate) pair: Pair,
}

/// Rows of a strip with three more above and below, each filled up to whole vectors, and what is summed along them.
struct Strip {
    width: usize,
    /// `width`, filled up.
    stride: usize,
    /// Rows that are matched.
    rows: Range<usize>,
    height: usize,
    /// Luma, mean and inverse deviation of the reference: `[rows + 6, stride]`.
    luma: Vec<f32>,
    mean: Vec<f32>,
    inverse_deviation: Vec<f32>,
    /// The surface and the inverse depths that are tried about it: `[rows + 6, stride]`, or empty if there is none.
    surface: Vec<f32>,
    depths: Vec<f32>,
    sampler: Sampler,
    /// A row that was warped.
    warped: Vec<f32>,
    /// The last seven: luma, and whether it was seen.
    ring: Vec<f32>,
    inside: Vec<f32>,
    /// Sums over seven rows of the warped luma, its square and its product with the reference, with margins.
    sums: [Vec<f32>; 3],
    /// The two smallest costs of any source, `[rows, stride]`; in the end their mean.
    smallest: Vec<f32>,
    second: Vec<f32>,
}

impl Strip {
    fn new(reference: Reference, surface: Option<&[f32]>, rows: Range<usize>) -> Self {
        let (width, height) = (reference.texture.width, reference.texture.height);
        let stride = width.next_multiple_of(LANES);
        let taken = rows.len() + 2 * RADIUS;
        let gather = |from: &[f32]| {
            let mut out = vec![0.0; taken * stride];
            for (row, out) in out.chunks_exact_mut(stride).enumerate() {
                let y = clamped(rows.start, row, height);
                out[..width].copy_from_slice(&from[y * width..][..width]);
            }
            out
        };
        let sums = || vec![0.0; stride + 2 * RADIUS];
        Self {
            width,
            stride,
            height,
            luma: gather(&reference.texture.values),
            mean: gather(&reference.statistics.mean),
            inverse_deviation: gather(&reference.statistics.inverse_deviation),
            depths: vec![0.0; if surface.is_some() { taken * stride } else { 0 }],
            surface: surface.map_or_else(Vec::new, gather),
            sampler: Sampler::new(width, stride),
            warped: vec![0.0; stride],
            ring: vec![0.0; SIDE * stride],
            inside: vec![0.0; SIDE * stride],
            sums: [sums(), sums(), sums()],
            smallest: vec![0.0; rows.len() * stride],
            second: vec![0.0; rows.len() * stride],
            rows,
        }
    }

    /// Costs of every row; they are in `smallest` then.
    fn match_all(&mut self, isa: Isa, sources: &[Source], hypothesis: Hypothesis) {
        dispatch(isa, Match { strip: self, sources, hypothesis });
    }

    /// Columns, in groups of `together`, that hold all pixels which a source may see at inverse depth `w`, and their windows.
    fn seen(&self, source: &Source, w: f64, together: usize) -> Range<usize> {
        let size = [source.texture.width, source.texture.height];
        let rows = self.rows.clone().map(|y| y as f64 + 0.5);
        let [from, to] = source.pair.seen(rows, w, size);
        if from > to {
            return 0..0;
        }
        // Rounding may move a place by far less than a pixel.
        let beside = RADIUS as f64 + 1.0;
        let (first, end) = ((from - beside).max(0.0) as usize, (to + beside).max(0.0).ceil() as usize);
        let end = end.min(self.stride).next_multiple_of(together);
        (first / together * together).min(end)..end
    }

    /// Costs of the pixels of row `row` (of the strip).
    fn costs(&self, row: usize) -> &[f32] {
        &self.smallest[row * self.stride..][..self.width]
    }
}

/// A hypothesis for a strip against all sources.
struct Match<'a, 's> {
    strip: &'a mut Strip,
    sources: &'a [Source<'s>],
    hypothesis: Hypothesis,
}

impl WithSimd for Match<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { strip, sources, hypothesis } = self;
        strip.smallest.fill(1.0);
        strip.second.fill(1.0);
        let plane = match hypothesis {
            Hypothesis::Plane(w) => Some(w),
            Hypothesis::Offset(offset, (farthest, nearest)) => {
                let (depths, _) = S::as_mut_simd_f32s(&mut strip.depths);
                let [offset, nearest, farthest] = splat(simd, [offset, nearest, farthest]);
                for (depth, &surface) in depths.iter_mut().zip(S::as_simd_f32s(&strip.surface).0) {
                    *depth = simd.max_f32s(simd.min_f32s(simd.add_f32s(surface, offset), nearest), farthest);
                }
                None
            }
        };
        for source in sources {
            match_source(simd, strip, source, plane);
        }
        if sources.len() > 1 {
            let half = simd.splat_f32s(0.5);
            let (first, _) = S::as_mut_simd_f32s(&mut strip.smallest);
            let (second, _) = S::as_simd_f32s(&strip.second);
            for (a, b) in first.iter_mut().zip(second) {
                *a = simd.mul_f32s(half, simd.add_f32s(*a, *b));
            }
        }
    }
}

/// Costs of a strip by one source, at the inverse depth `plane`, or at `depths` if there is none.
#[inline(always)]
fn match_source<S: Simd>(simd: S, strip: &mut Strip, source: &Source, plane: Option<f64>) {
    let (width, stride, first) = (strip.width, strip.stride, strip.rows.start);
    let columns = plane.map_or(0..stride, |w| strip.seen(source, w, TOGETHER.max(S::F32_LANES)));
    leave_outside(simd, strip, &columns);
    if columns.is_empty() {
        return;
    }
    strip.ring.fill(0.0);
    strip.sums.iter_mut().for_each(|sums| sums.fill(0.0));
    for row in 0..strip.rows.len() + 2 * RADIUS {
        let y = clamped(first, row, strip.height);
        let slot = row % SIDE * stride;
        let left = if row < SIDE { row } else { row - SIDE };
        let luma = [row, left].map(|row| &strip.luma[row * stride..][..stride][columns.clone()]);
        let mut window = Window::<S>::new(&mut strip.sums, luma, &columns);
        if row > 0 && y == clamped(first, row - 1, strip.height) {
            let last = (row - 1) % SIDE * stride;
            strip.inside.copy_within(last..last + stride, slot);
            strip.warped.copy_from_slice(&strip.ring[last..][..stride]);
            let (warped, _) = S::as_simd_f32s(&strip.warped[columns.clone()]);
            let (ring, _) = S::as_mut_simd_f32s(&mut strip.ring[slot..][..stride][columns.clone()]);
            for (i, (ring, &warped)) in ring.iter_mut().zip(warped).enumerate() {
                window.replace(simd, i, ring, warped);
            }
        } else {
            let inside = &mut strip.inside[slot..][..stride];
            let depths = match plane {
                Some(w) => Depths::Plane(w),
                None => Depths::Surface(&strip.depths[row * stride..][..stride]),
            };
            let from = (&source.pair, source.texture);
            strip.sampler.locate(simd, from, (y, columns.clone()), depths, inside);
            let (ring, _) = S::as_mut_simd_f32s(&mut strip.ring[slot..][..stride][columns.clone()]);
            strip.sampler.sample(
                simd,
                source.texture,
                columns.clone(),
                #[inline(always)]
                |i, warped| window.replace(simd, i, &mut ring[i], warped),
            );
        }
        if row >= 2 * RADIUS {
            strip.sums.iter_mut().for_each(|sums| extend_margins(sums, width));
            let out = (row - 2 * RADIUS) * stride;
            let centre = row - RADIUS;
            keep_two_smallest(
                simd,
                strip.sums.each_ref().map(|sums| &sums[columns.start..columns.end + 2 * RADIUS]),
                [
                    &strip.mean[centre * stride..][..stride][columns.clone()],
                    &strip.inverse_deviation[centre * stride..][..stride][columns.clone()],
                    &strip.inside[centre % SIDE * stride..][..stride][columns.clone()],
                ],
                &mut strip.smallest[out..][..stride][columns.clone()],
                &mut strip.second[out..][..stride][columns.clone()],
            );
        }
    }
}

/// Costs of all rows where no pixel of a column is seen by a source.
#[inline(always)]
fn leave_outside<S: Simd>(simd: S, strip: &mut Strip, seen: &Range<usize>) {
    let outside = simd.splat_f32s(OUTSIDE_COST);
    let stride = strip.stride;
    let rows = strip.smallest.chunks_exact_mut(stride).zip(strip.second.chunks_exact_mut(stride));
    for (smallest, second) in rows {
        for columns in [0..seen.start, seen.end..stride] {
            let (smallest, _) = S::as_mut_simd_f32s(&mut smallest[columns.clone()]);
            let (second, _) = S::as_mut_simd_f32s(&mut second[columns]);
            for (smallest, second) in smallest.iter_mut().zip(second) {
                put_among(simd, outside, smallest, second);
            }
        }
    }
}

/// Puts a cost where it belongs among the two smallest.
#[inline(always)]
fn put_among<S: Simd>(simd: S, cost: S::f32s, smallest: &mut S::f32s, second: &mut S::f32s) {
    *second = simd.min_f32s(*second, simd.max_f32s(*smallest, cost));
    *smallest = simd.min_f32s(*smallest, cost);
}

/// Sums over the rows of windows, and the luma of the reference in the row that enters and in the one that leaves.
struct Window<'a, S: Simd> {
    sums: [&'a mut [S::f32s]; 3],
    luma: [&'a [S::f32s]; 2],
}

impl<'a, S: Simd> Window<'a, S> {
    #[inline(always)]
    fn new(sums: &'a mut [Vec<f32>; 3], luma: [&'a [f32]; 2], columns: &Range<usize>) -> Self {
        let n = columns.len() / S::F32_LANES;
        let of_columns = RADIUS + columns.start..RADIUS + columns.end;
        Self {
            sums: sums.each_mut().map(|sums| &mut S::as_mut_simd_f32s(&mut sums[of_columns.clone()]).0[..n]),
            luma: luma.map(|row| &S::as_simd_f32s(row).0[..n]),
        }
    }

    /// Takes the row that leaves the window out of the sums of vector number `i`, and adds the one that enters, which takes its place.
    #[inline(always)]
    fn replace(&mut self, simd: S, i: usize, leaving: &mut S::f32s, entering: S::f32s) {
        let ([sum, squares, products], [new_luma, old_luma]) = (&mut self.sums, self.luma);
        let (a, b) = (entering, *leaving);
        sum[i] = simd.add_f32s(sum[i], simd.sub_f32s(a, b));
        squares[i] = simd.negate_mul_add_e_f32s(b, b, simd.mul_add_e_f32s(a, a, squares[i]));
        products[i] =
            simd.negate_mul_add_e_f32s(b, old_luma[i], simd.mul_add_e_f32s(a, new_luma[i], products[i]));
        *leaving = a;
    }
}

/// ZNCC costs of one row, put where they belong among the two smallest so far.
#[inline(always)]
fn keep_two_smallest<S: Simd>(
    simd: S,
    sums: [&[f32]; 3],
    [mean, inverse_deviation, inside]: [&[f32]; 3],
    smallest: &mut [f32],
    second: &mut [f32],
) {
    let n = smallest.len() / S::F32_LANES;
    let [mean, inverse_deviation, inside] =
        [mean, inverse_deviation, inside].map(|row| &S::as_simd_f32s(row).0[..n]);
    let smallest = &mut S::as_mut_simd_f32s(smallest).0[..n];
    let second = &mut S::as_mut_simd_f32s(second).0[..n];
    let [share, noise, outside] = splat(simd, [1.0 / WINDOW, NOISE_VARIANCE, OUTSIDE_COST]);
    let [zero, one] = splat(simd, [0.0, 1.0]);
    for i in 0..n {
        let mut means = [zero; 3];
        for (mean, sums) in means.iter_mut().zip(sums) {
            // The window's seven columns of as many pixels as a vector has.
            let columns = &sums[i * S::F32_LANES..][..S::F32_LANES + 2 * RADIUS];
            let mut sevens = [zero; SIDE];
            for (by, seven) in sevens.iter_mut().enumerate() {
                *seven = S::as_simd_f32s(&columns[by..][..S::F32_LANES]).0[0];
            }
            let [a, b, c, d, e, f, g] = sevens;
            let (ab, cd) = (simd.add_f32s(a, b), simd.add_f32s(c, d));
            let efg = simd.add_f32s(simd.add_f32s(e, f), g);
            *mean = simd.mul_f32s(simd.add_f32s(simd.add_f32s(ab, cd), efg), share);
        }
        let [warped_mean, square, product] = means;
        let variance = simd.negate_mul_add_e_f32s(warped_mean, warped_mean, square);
        let covariance = simd.negate_mul_add_e_f32s(warped_mean, mean[i], product);
        let deviation = simd.sqrt_f32s(simd.add_f32s(simd.max_f32s(variance, zero), noise));
        let correlation = simd.div_f32s(simd.mul_f32s(covariance, inverse_deviation[i]), deviation);
        let cost = simd.min_f32s(simd.max_f32s(simd.sub_f32s(one, correlation), zero), one);
        let cost = select(simd, simd.greater_than_f32s(inside[i], zero), cost, outside);
        put_among(simd, cost, &mut smallest[i], &mut second[i]);
    }
}

/// The strips of a picture: their rows.
fn strips(height: usize) -> impl IndexedParallelIterator<Item = Range<usize>> {
    (0..height.div_ceil(STRIP)).into_par_iter().map(move |strip| {
        let first = strip * STRIP;
        first..(first + STRIP).min(height)
    })
}

/// The cost volume `[height, width, planes]`, 0..[`COST_LEVELS`]. There are as many planes as hypotheses, filled up to whole vectors with
/// costs beyond all others.
pub(crate) fn volume(isa: Isa, reference: Reference, sources: &[Source], hypotheses: Hypotheses) -> Vec<u16> {
    let (width, height) = (reference.texture.width, reference.texture.height);
    let planes = hypotheses.len().next_multiple_of(sgm::LANES);
    let mut volume = vec![0; width * height * planes];
    volume.par_chunks_mut(STRIP * width * planes).zip(strips(height)).for_each(|(volume, rows)| {
        let mut strip = Strip::new(reference, hypotheses.surface(), rows);
        let pixels = strip.rows.len() * width;
        let mut by_plane = vec![BEYOND; planes * pixels];
        let tried = (0..hypotheses.len()).map(|index| hypotheses.get(index));
        for (out, hypothesis) in by_plane.chunks_exact_mut(pixels).zip(tried) {
            strip.match_all(isa, sources, hypothesis);
            compiled_for!(isa, {
                for (row, out) in out.chunks_exact_mut(width).enumerate() {
                    for (out, &cost) in out.iter_mut().zip(strip.costs(row)) {
                        // Adding 2²³ rounds, and leaves the number in the low bits.
                        *out = (cost * COST_LEVELS + 8_388_608.0).to_bits() as u16;
                    }
                }
            });
        }
        transpose(&by_plane, volume, pixels, planes);
    });
    volume
}

/// `[planes, pixels]` to `[pixels, planes]`, in blocks that fit the first-level cache.
fn transpose(by_plane: &[u16], by_pixel: &mut [u16], pixels: usize, planes: usize) {
    const BLOCK: usize = 64;
    // Planes whose costs of a pixel are stored together: a divisor of the lanes to which planes are filled up.
    const TOGETHER: usize = 4;
    for start in (0..pixels).step_by(BLOCK) {
        let block = start..(start + BLOCK).min(pixels);
        let by_pixel = &mut by_pixel[block.start * planes..block.end * planes];
        for (group, rows) in by_plane.chunks_exact(TOGETHER * pixels).enumerate() {
            let [a, b, c, d]: [&[u16]; TOGETHER] =
                std::array::from_fn(|k| &rows[k * pixels..][block.clone()]);
            let (places, _) = by_pixel.as_chunks_mut::<TOGETHER>();
            let places = places.iter_mut().skip(group).step_by(planes / TOGETHER);
            for ((((place, a), b), c), d) in places.zip(a).zip(b).zip(c).zip(d) {
                *place = [*a, *b, *c, *d];
            }
        }
    }
}

/// The costs `[height, width]`, 0..1, of a surface. Windows follow it: each of their pixels is warped by its own depth.
pub(crate) fn surface_costs(
    isa: Isa,
    reference: Reference,
    sources: &[Source],
    surface: &[f32],
    ends: (f32, f32),
) -> Vec<f32> {
    let (width, height) = (reference.texture.width, reference.texture.height);
    let mut costs = vec![0.0; width * height];
    costs.par_chunks_mut(STRIP * width).zip(strips(height)).for_each(|(costs, rows)| {
        let mut strip = Strip::new(reference, Some(surface), rows);
        strip.match_all(isa, sources, Hypothesis::Offset(0.0, ends));
        for (row, costs) in costs.chunks_exact_mut(width).enumerate() {
            costs.copy_from_slice(strip.costs(row));
        }
    });
    costs
}

#[cfg(test)]
mod tests;
