//! The pipeline over a band of rows: moments of the windows, index, and the way back to the pixels, each as soon as its
//! rows are there, so that what lies between stays in the cache.

use super::SSIM_WINDOW;
use super::filter::{CHANNELS, REACH, ROWS, SPAN, STRIP, horizontal, taps, vertical};
use super::index;
use super::vector::{Real, Twice, Vector};

/// Rows above that see a row of pixels.
const ABOVE: usize = SSIM_WINDOW - 1;

/// Values of a row of scratch: whole strips.
pub(super) fn stride(width: usize) -> usize {
    (width * CHANNELS).next_multiple_of(STRIP)
}

/// Two pictures `[height, width, 3]` of equal size, at least [`SSIM_WINDOW`] wide and high.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub(super) a: &'a [f32],
    pub(super) b: &'a [f32],
    /// What b is taken relative to: its mean.
    pub(super) shift: f32,
    /// What a - b is taken relative to: its mean, 0 where a is b.
    pub(super) offset: f32,
    pub(super) width: usize,
}

/// What a pass down the columns reads of a strip: three maps.
type Spans<T> = [[[T; STRIP]; SPAN]; 3];

/// What a band needs between its steps.
#[derive(Debug, Clone)]
pub(super) struct Scratch<T> {
    /// Of the pictures that it is for.
    width: usize,
    /// `[moment][ROWS][stride]`, and [`REACH`] more: moments after the filter down the columns.
    columns: Vec<T>,
    /// `[moment][REACH + stride + REACH]`: derivatives by the moments of one row of windows, between zeros.
    derivatives: Vec<T>,
    /// By strip: them after the filter along the row. When pixels `y..y + ROWS` are pulled back, row i is that of
    /// window row y - [`ABOVE`] + i, or 0 where there is none.
    history: Vec<Spans<T>>,
}

impl<T> Default for Scratch<T> {
    fn default() -> Self {
        Self { width: 0, columns: Vec::new(), derivatives: Vec::new(), history: Vec::new() }
    }
}

impl<T: Real> Scratch<T> {
    /// Makes it for pictures of this width: what lies between rows is 0 then and is never written.
    fn fit(&mut self, width: usize) {
        if self.width != width {
            let stride = stride(width);
            self.width = width;
            self.columns = vec![T::default(); 3 * ROWS * stride + REACH];
            self.derivatives = vec![T::default(); 3 * (REACH + stride + REACH)];
            self.history = Vec::new();
        }
    }

    /// What a gradient needs besides, most of all memory.
    fn fit_history(&mut self) {
        let strips = stride(self.width) / STRIP;
        if self.history.len() != strips {
            self.history = vec![[[[T::default(); STRIP]; SPAN]; 3]; strips];
        }
    }
}

/// The values of a row from `start` on; with zeros beyond its end, in `padded`.
#[inline(always)]
fn strip_of<'a>(row: &'a [f32], start: usize, padded: &'a mut [f32; STRIP]) -> &'a [f32; STRIP] {
    match row[start..].first_chunk() {
        Some(strip) => strip,
        None => {
            padded[..row.len() - start].copy_from_slice(&row[start..]);
            padded
        }
    }
}

impl<'a> Pair<'a> {
    fn height(self) -> usize {
        self.a.len() / (self.width * CHANNELS)
    }

    /// Row `y` of both. The last one stands for those beyond the end: what is made of it is not used.
    #[inline(always)]
    fn rows(self, y: usize) -> (&'a [f32], &'a [f32]) {
        let row = self.width * CHANNELS;
        let start = y.min(self.height() - 1) * row;
        (&self.a[start..start + row], &self.b[start..start + row])
    }
}

/// Moments of window rows `y..y + ROWS` after the filter down the columns, into `columns`.
#[inline(always)]
fn filter_columns<V: Vector>(pair: Pair, taps: &[V; SSIM_WINDOW], y: usize, columns: &mut [V::Real]) {
    let stride = stride(pair.width);
    let (shift, offset) = (V::splat(f64::from(pair.shift)), V::splat(f64::from(pair.offset)));
    let mut products: Spans<V::Real> = [[[V::Real::default(); STRIP]; SPAN]; 3];
    let mut ends = [[0.0; STRIP]; 2];
    for strip in (0..stride).step_by(STRIP) {
        let [differences, squares, products_with_b] = &mut products;
        for i in 0..SPAN {
            let (a, b) = pair.rows(y + i);
            let [end_a, end_b] = &mut ends;
            let (a, b) = (strip_of(a, strip, end_a), strip_of(b, strip, end_b));
            for block in 0..STRIP / V::LANES {
                let start = block * V::LANES;
                let b = V::of_picture(b, start);
                let d = V::of_picture(a, start) - b - offset;
                d.store(&mut differences[i], start);
                (d * d).store(&mut squares[i], start);
                (d * (b - shift)).store(&mut products_with_b[i], start);
            }
        }
        for moment in 0..3 {
            let mut rows = columns[moment * ROWS * stride..].chunks_exact_mut(stride);
            let mut filtered = [(); ROWS].map(|()| {
                let row = rows.next().expect("there is room for all rows");
                row[strip..].first_chunk_mut().expect("rows are whole strips")
            });
            vertical(taps, &products[moment], &mut filtered);
        }
    }
}

/// Row `j` of each moment in `columns`, with the [`REACH`] values after it.
#[inline(always)]
fn filtered_row<T>(columns: &[T], stride: usize, j: usize) -> [&[T]; 3] {
    let row = |moment: usize| &columns[(moment * ROWS + j) * stride..][..stride + REACH];
    [row(0), row(1), row(2)]
}

/// `[row][stride]` mean and contrast of the windows in rows `y..`, as many rows as there is room for, up to [`ROWS`].
#[inline(always)]
pub(super) fn statistics<V: Vector<Real = f64>>(
    pair: Pair,
    y: usize,
    means: &mut [f64],
    contrasts: &mut [f64],
    scratch: &mut Scratch<f64>,
) {
    scratch.fit(pair.width);
    let (taps, stride) = (taps(), stride(pair.width));
    filter_columns::<V>(pair, &taps, y, &mut scratch.columns);
    for j in 0..means.len() / stride {
        let maps = filtered_row(&scratch.columns, stride, j);
        let means = &mut means[j * stride..][..stride];
        let contrasts = &mut contrasts[j * stride..][..stride];
        for start in (0..pair.width * CHANNELS - REACH).step_by(V::LANES) {
            let moments = horizontal::<V>(&taps, maps, start);
            let (mean, contrast) = index::mean_and_contrast(moments);
            mean.store(means, start);
            contrast.store(contrasts, start);
        }
    }
}

/// A band of rows to be done.
#[derive(Clone, Copy)]
pub(super) struct Band<'a, T> {
    pub(super) pair: Pair<'a>,
    /// `[window rows][stride]` statistics of b.
    pub(super) means: &'a [T],
    pub(super) contrasts: &'a [T],
    /// The first row of pixels, and of windows.
    pub(super) first: usize,
    /// What the derivative by the sum of all windows is multiplied by.
    pub(super) weight: f32,
}

/// `sums`, one for each row of pixels in the band, takes the sums of 1 - SSIM over the windows that begin in it;
/// `gradient`, as many rows of pixels, has the derivative added, unless it is empty.
#[inline(always)]
pub(super) fn band<V: Vector>(
    band: Band<V::Real>,
    sums: &mut [f64],
    gradient: &mut [f32],
    scratch: &mut Scratch<V::Real>,
) {
    let (row, first) = (band.pair.width * CHANNELS, band.first);
    scratch.fit(band.pair.width);
    let taps = taps::<V>();
    let with_gradient = !gradient.is_empty();
    if with_gradient {
        scratch.fit_history();
        // The rows above belong to the band before: their derivatives reach into this one, their sums are done there.
        let above = first.min(ABOVE);
        for spans in &mut scratch.history {
            for rows in spans {
                rows[..ABOVE - above].fill([V::Real::default(); STRIP]);
            }
        }
        for start in (0..above).step_by(ROWS) {
            let count = ROWS.min(above - start);
            let place = Some(ABOVE - above + start);
            window_rows(band, &taps, first - above + start, &mut [0.0; ROWS][..count], place, scratch);
        }
    }
    for (sums, y) in sums.chunks_mut(ROWS).zip((first..).step_by(ROWS)) {
        window_rows(band, &taps, y, sums, with_gradient.then_some(ABOVE), scratch);
        if with_gradient {
            let gradient = &mut gradient[(y - first) * row..][..sums.len() * row];
            pull_back(band, &taps, y, gradient, &mut scratch.history);
        }
    }
}

/// Sums of 1 - SSIM over window rows from `y` on, at most [`ROWS`], 0 for those that there are not; their derivatives go
/// to the rows of the history from `place` on.
#[inline(always)]
fn window_rows<V: Vector>(
    band: Band<V::Real>,
    taps: &[V; SSIM_WINDOW],
    y: usize,
    sums: &mut [f64],
    place: Option<usize>,
    scratch: &mut Scratch<V::Real>,
) {
    let windows = band.pair.height() + 1 - SSIM_WINDOW;
    if y < windows {
        filter_columns(band.pair, taps, y, &mut scratch.columns);
    }
    for (j, sum) in sums.iter_mut().enumerate() {
        if y + j < windows {
            *sum = index_row::<Twice<V>>(band, y + j, j, scratch);
            if let Some(place) = place {
                filter_derivatives::<Twice<V>>(&scratch.derivatives, place + j, &mut scratch.history);
            }
        } else if let Some(place) = place {
            for spans in &mut scratch.history {
                for rows in spans {
                    rows[place + j] = [V::Real::default(); STRIP];
                }
            }
        }
    }
}

/// Sum of 1 - SSIM over window row `y`, row `j` of the columns, and its derivatives.
#[inline(always)]
fn index_row<V: Vector>(band: Band<V::Real>, y: usize, j: usize, scratch: &mut Scratch<V::Real>) -> f64 {
    let taps = taps::<V>();
    let (row, stride) = (band.pair.width * CHANNELS, stride(band.pair.width));
    let (shift, offset) = (V::splat(f64::from(band.pair.shift)), V::splat(f64::from(band.pair.offset)));
    let maps = filtered_row(&scratch.columns, stride, j);
    let means = &band.means[y * stride..][..stride];
    let contrasts = &band.contrasts[y * stride..][..stride];
    let (by_mean, rest) = scratch.derivatives.split_at_mut(REACH + stride + REACH);
    let (by_square, by_product) = rest.split_at_mut(REACH + stride + REACH);
    let by_mean = &mut by_mean[REACH..][..stride];
    let by_square = &mut by_square[REACH..][..stride];
    let by_product = &mut by_product[REACH..][..stride];
    let mut total = V::splat(0.0);
    for start in (0..row - REACH).step_by(V::LANES) {
        // First, so that the bounds are checked before anything is computed.
        let local = (V::load(means, start), V::load(contrasts, start));
        let moments = horizontal(&taps, maps, start);
        let (loss, derivatives) = index::loss(moments, local, shift, offset);
        total = total + loss;
        derivatives[0].store(by_mean, start);
        derivatives[1].store(by_square, start);
        derivatives[2].store(by_product, start);
    }
    total.sum()
}

/// A row of derivatives along the row, to row `place` of the history.
#[inline(always)]
fn filter_derivatives<V: Vector>(derivatives: &[V::Real], place: usize, history: &mut [Spans<V::Real>]) {
    let taps = taps::<V>();
    let length = derivatives.len() / 3;
    let maps = [&derivatives[..length], &derivatives[length..2 * length], &derivatives[2 * length..]];
    for (strip, [by_mean, by_square, by_product]) in history.iter_mut().enumerate() {
        let (by_mean, by_square, by_product) =
            (&mut by_mean[place], &mut by_square[place], &mut by_product[place]);
        for block in 0..STRIP / V::LANES {
            let start = block * V::LANES;
            let values = horizontal(&taps, maps, strip * STRIP + start);
            values[0].store(by_mean, start);
            values[1].store(by_square, start);
            values[2].store(by_product, start);
        }
    }
}

/// Adds the derivative by the rows of pixels from `y` on, at most [`ROWS`], and moves the history on by [`ROWS`].
#[inline(always)]
fn pull_back<V: Vector>(
    band: Band<V::Real>,
    taps: &[V; SSIM_WINDOW],
    y: usize,
    gradient: &mut [f32],
    history: &mut [Spans<V::Real>],
) {
    let row = band.pair.width * CHANNELS;
    let mut filtered = [[[V::Real::default(); STRIP]; ROWS]; 3];
    let mut ends = [[0.0; STRIP]; 3];
    for (strip, spans) in (0..).step_by(STRIP).zip(history) {
        for (rows, filtered) in spans.iter_mut().zip(&mut filtered) {
            vertical(taps, rows, &mut filtered.each_mut());
            rows.copy_within(ROWS.., 0);
        }
        let [by_mean, by_square, by_product] = &filtered;
        for (j, gradient) in gradient.chunks_exact_mut(row).enumerate() {
            let (a, b) = band.pair.rows(y + j);
            let [end_a, end_b, end] = &mut ends;
            let (a, b) = (strip_of(a, strip, end_a), strip_of(b, strip, end_b));
            let by = [&by_mean[j], &by_square[j], &by_product[j]];
            match gradient[strip..].first_chunk_mut() {
                Some(gradient) => add_strip::<V>(by, a, b, band, gradient),
                None => {
                    let gradient = &mut gradient[strip..];
                    end[..gradient.len()].copy_from_slice(gradient);
                    add_strip::<V>(by, a, b, band, end);
                    gradient.copy_from_slice(&end[..gradient.len()]);
                }
            }
        }
    }
}

/// Adds the derivative by the pixels of a strip, from the filtered derivatives by the three moments.
#[inline(always)]
fn add_strip<V: Vector>(
    [by_mean, by_square, by_product]: [&[V::Real; STRIP]; 3],
    a: &[f32; STRIP],
    b: &[f32; STRIP],
    band: Band<V::Real>,
    gradient: &mut [f32; STRIP],
) {
    let (shift, offset) = (V::splat(f64::from(band.pair.shift)), V::splat(f64::from(band.pair.offset)));
    let weight = V::splat(f64::from(band.weight));
    for block in 0..STRIP / V::LANES {
        let start = block * V::LANES;
        let b = V::of_picture(b, start);
        let d = V::of_picture(a, start) - b - offset;
        let by_d = V::load(by_square, start).mul_add(d + d, V::load(by_mean, start));
        let by_a = V::load(by_product, start).mul_add(b - shift, by_d);
        by_a.mul_add(weight, V::of_picture(gradient, start)).to_picture(gradient, start);
    }
}
