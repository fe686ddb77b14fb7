//! The matching cost: zero-mean normalised cross-correlation (ZNCC) of 7×7 windows, the best of several sources.

use crate::pair::Pair;
use crate::texture::{RowScratch, Texture};
use multiversion::multiversion;
use rayon::prelude::*;

/// Half the window: 7×7 pixels.
const RADIUS: usize = 3;
const WINDOW: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
/// Added to both variances (8-bit levels²): noise of a flat patch must not correlate.
const NOISE_VARIANCE: f32 = 2.0;
/// Cost where the point lies outside a source.
const OUTSIDE_COST: f32 = 0.75;
/// Rows per task: the buffers of a strip stay in the second-level cache.
const STRIP: usize = 32;

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
fn extend_margins(columns: &mut [f32], n: usize) {
    let (first, last) = (columns[RADIUS], columns[RADIUS + n - 1]);
    columns[..RADIUS].fill(first);
    columns[RADIUS + n..].fill(last);
}

/// Sum of the seven columns around each pixel.
#[inline(always)]
fn seven(columns: &[f32], i: usize) -> f32 {
    let c = &columns[i..i + 7];
    ((c[0] + c[1]) + (c[2] + c[3])) + ((c[4] + c[5]) + c[6])
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
            for offset in 0..=2 * RADIUS {
                let row = &texture.values[clamped(y, offset, height) * width..][..width];
                for (x, &v) in row.iter().enumerate() {
                    sums[RADIUS + x] += v;
                    squares[RADIUS + x] += v * v;
                }
            }
            extend_margins(&mut sums, width);
            extend_margins(&mut squares, width);
            for x in 0..width {
                mean[x] = seven(&sums, x) / WINDOW;
                let variance = (seven(&squares, x) / WINDOW - mean[x] * mean[x]).max(0.0);
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

/// Running column sums of the warped picture, its square and its product with the reference.
struct ColumnSums {
    warped: Vec<f32>,
    squares: Vec<f32>,
    products: Vec<f32>,
}

#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
fn add_row(warped: &[f32], reference: &[f32], sums: [&mut [f32]; 3], sign: f32) {
    let n = warped.len();
    let reference = &reference[..n];
    let [sum, squares, products] = sums;
    let (sum, squares, products) = (&mut sum[..n], &mut squares[..n], &mut products[..n]);
    for i in 0..n {
        let signed = warped[i] * sign;
        sum[i] += signed;
        squares[i] += signed * warped[i];
        products[i] += signed * reference[i];
    }
}

/// ZNCC cost of one row, put where it belongs among the two smallest so far.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
fn keep_two_smallest(
    [warped, squares, products]: [&[f32]; 3],
    [mean, inverse_deviation, inside]: [&[f32]; 3],
    smallest: &mut [f32],
    second: &mut [f32],
) {
    let n = smallest.len();
    let (mean, inverse_deviation, inside) = (&mean[..n], &inverse_deviation[..n], &inside[..n]);
    let second = &mut second[..n];
    let (warped, squares, products) = (&warped[..n + 6], &squares[..n + 6], &products[..n + 6]);
    for i in 0..n {
        let warped_mean = seven(warped, i) * (1.0 / WINDOW);
        let variance = (seven(squares, i) * (1.0 / WINDOW) - warped_mean * warped_mean).max(0.0);
        let covariance = seven(products, i) * (1.0 / WINDOW) - warped_mean * mean[i];
        let correlation = covariance * inverse_deviation[i] / (variance + NOISE_VARIANCE).sqrt();
        let cost = (1.0 - correlation).clamp(0.0, 1.0);
        let cost = if inside[i] > 0.0 { cost } else { OUTSIDE_COST };
        second[i] = second[i].min(smallest[i].max(cost));
        smallest[i] = smallest[i].min(cost);
    }
}

/// One strip of the reference, warped row by row from one source.
struct Strip {
    /// `[rows + 6, width]`.
    warped: Vec<f32>,
    /// `[rows + 6, width]`.
    inside: Vec<f32>,
    columns: ColumnSums,
    scratch: RowScratch,
}

impl Strip {
    fn new(width: usize) -> Self {
        let sums = vec![0.0; width + 2 * RADIUS];
        Self {
            warped: vec![0.0; (STRIP + 2 * RADIUS) * width],
            inside: vec![0.0; (STRIP + 2 * RADIUS) * width],
            columns: ColumnSums { warped: sums.clone(), squares: sums.clone(), products: sums },
            scratch: RowScratch::new(width),
        }
    }

    /// Costs of the rows `first..first + n_rows` against one source, at the inverse depths that `w` gives per row.
    fn match_source<'w>(
        &mut self,
        reference: &Reference,
        source: &Source,
        [first, n_rows]: [usize; 2],
        w: impl Fn(usize) -> &'w [f32],
        smallest: &mut [f32],
        second: &mut [f32],
    ) {
        let (width, height) = (reference.texture.width, reference.texture.height);
        let span = |row: usize| row * width..(row + 1) * width;
        for row in 0..n_rows + 2 * RADIUS {
            let y = clamped(first, row, height);
            if row > 0 && y == clamped(first, row - 1, height) {
                self.warped.copy_within(span(row - 1), row * width);
                self.inside.copy_within(span(row - 1), row * width);
                continue;
            }
            let (warped, inside) = (&mut self.warped[span(row)], &mut self.inside[span(row)]);
            source.texture.warp_row(&source.pair, y, w(y), warped, inside, &mut self.scratch);
            if let Some(visible) = source.visible {
                for (inside, &visible) in inside.iter_mut().zip(&visible[span(y)]) {
                    *inside *= visible;
                }
            }
        }
        let columns = &mut self.columns;
        columns.warped.fill(0.0);
        columns.squares.fill(0.0);
        columns.products.fill(0.0);
        let centre = RADIUS..RADIUS + width;
        let add = |columns: &mut ColumnSums, row: usize, sign: f32| {
            let sums = [
                &mut columns.warped[centre.clone()],
                &mut columns.squares[centre.clone()],
                &mut columns.products[centre.clone()],
            ];
            let y = clamped(first, row, height);
            add_row(&self.warped[span(row)], &reference.texture.values[span(y)], sums, sign);
        };
        for row in 0..2 * RADIUS {
            add(columns, row, 1.0);
        }
        for row in 0..n_rows {
            add(columns, row + 2 * RADIUS, 1.0);
            extend_margins(&mut columns.warped, width);
            extend_margins(&mut columns.squares, width);
            extend_margins(&mut columns.products, width);
            let y = first + row;
            keep_two_smallest(
                [&columns.warped, &columns.squares, &columns.products],
                [
                    &reference.statistics.mean[span(y)],
                    &reference.statistics.inverse_deviation[span(y)],
                    &self.inside[span(row + RADIUS)],
                ],
                &mut smallest[span(row)],
                &mut second[span(row)],
            );
            add(columns, row, -1.0);
        }
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
    /// 1 where the reference pixel is seen from the source, as far as known.
    pub(crate) visible: Option<&'a [f32]>,
}

/// Runs `fill(first row, its n rows, smallest, second)` for each strip of the picture in parallel, and gathers what it
/// returns, one vector per strip.
fn by_strips<T: Send>(height: usize, work: impl Fn(usize, usize) -> T + Sync) -> Vec<T> {
    let strips = height.div_ceil(STRIP);
    (0..strips)
        .into_par_iter()
        .map(|strip| {
            let first = strip * STRIP;
            work(first, STRIP.min(height - first))
        })
        .collect()
}

/// Cost of the best two sources per pixel, 0..1; the smaller one alone where there is a single source.
fn mean_of_two(smallest: &[f32], second: &[f32], sources: usize) -> impl Iterator<Item = f32> {
    smallest.iter().zip(second).map(move |(&a, &b)| if sources > 1 { 0.5 * (a + b) } else { a })
}

/// The cost volume `[height, width, planes]`, 255 = no correlation, of fronto-parallel planes at `inverse_depths`.
pub(crate) fn plane_costs(reference: Reference, sources: &[Source], inverse_depths: &[f32]) -> Vec<u8> {
    let (width, height) = (reference.texture.width, reference.texture.height);
    let planes = inverse_depths.len();
    let mut volume = vec![0_u8; width * height * planes];
    volume.par_chunks_mut(STRIP * width * planes).enumerate().for_each(|(strip_index, volume)| {
        let first = strip_index * STRIP;
        let n_rows = STRIP.min(height - first);
        let pixels = n_rows * width;
        let mut strip = Strip::new(width);
        let (mut smallest, mut second) = (vec![0.0; pixels], vec![0.0; pixels]);
        let mut by_plane = vec![0_u8; planes * pixels];
        for (plane, &inverse_depth) in by_plane.chunks_exact_mut(pixels).zip(inverse_depths) {
            smallest.fill(1.0);
            second.fill(1.0);
            let w = vec![inverse_depth; width];
            for source in sources {
                strip.match_source(&reference, source, [first, n_rows], |_| &w, &mut smallest, &mut second);
            }
            for (out, cost) in plane.iter_mut().zip(mean_of_two(&smallest, &second, sources.len())) {
                *out = (cost * 255.0 + 0.5) as u8;
            }
        }
        transpose(&by_plane, volume, pixels, planes);
    });
    volume
}

/// `[planes, pixels]` to `[pixels, planes]`, in blocks that fit the first-level cache.
fn transpose(by_plane: &[u8], by_pixel: &mut [u8], pixels: usize, planes: usize) {
    const BLOCK: usize = 64;
    for start in (0..pixels).step_by(BLOCK) {
        let end = (start + BLOCK).min(pixels);
        for plane in 0..planes {
            for pixel in start..end {
                by_pixel[pixel * planes + plane] = by_plane[plane * pixels + pixel];
            }
        }
    }
}

/// The costs `[height, width]`, 0..1, at one inverse depth per pixel. Windows follow the surface: each of their pixels
/// is warped by its own depth.
pub(crate) fn surface_costs(reference: Reference, sources: &[Source], inverse_depth: &[f32]) -> Vec<f32> {
    let (width, height) = (reference.texture.width, reference.texture.height);
    let strips = by_strips(height, |first, n_rows| {
        let mut strip = Strip::new(width);
        let (mut smallest, mut second) = (vec![1.0; n_rows * width], vec![1.0; n_rows * width]);
        for source in sources {
            let w = |y: usize| &inverse_depth[y * width..][..width];
            strip.match_source(&reference, source, [first, n_rows], w, &mut smallest, &mut second);
        }
        mean_of_two(&smallest, &second, sources.len()).collect::<Vec<_>>()
    });
    strips.concat()
}
