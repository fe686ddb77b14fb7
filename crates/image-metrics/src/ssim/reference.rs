//! A picture to compare with, and what of the index depends on it alone.

use super::SSIM_WINDOW;
#[cfg(target_arch = "x86_64")]
use super::avx2;
use super::band::{Band, Pair, Scratch, band, statistics, stride};
use super::filter::{CHANNELS, REACH, ROWS};
use super::vector::{Portable, Real};
use rayon::prelude::*;

/// Fewest rows of a band with a gradient: ten more are done again by the next one.
const FEWEST_ROWS: usize = 24;

/// A number that bands are compiled for.
pub(super) trait Number: Real {
    /// [`band`] in the best vectors of this processor.
    fn band(work: Band<Self>, sums: &mut [f64], gradient: &mut [f32], scratch: &mut Scratch<Self>);
}

impl Number for f32 {
    fn band(work: Band<f32>, sums: &mut [f64], gradient: &mut [f32], scratch: &mut Scratch<f32>) {
        #[cfg(target_arch = "x86_64")]
        if avx2::available() {
            return avx2::band_f32(work, sums, gradient, scratch);
        }
        band::<Portable<f32, 4>>(work, sums, gradient, scratch);
    }
}

impl Number for f64 {
    fn band(work: Band<f64>, sums: &mut [f64], gradient: &mut [f32], scratch: &mut Scratch<f64>) {
        #[cfg(target_arch = "x86_64")]
        if avx2::available() {
            return avx2::band_f64(work, sums, gradient, scratch);
        }
        band::<Portable<f64, 2>>(work, sums, gradient, scratch);
    }
}

/// [`statistics`] in the best vectors of this processor.
fn statistics_f64(
    pair: Pair,
    y: usize,
    means: &mut [f64],
    contrasts: &mut [f64],
    scratch: &mut Scratch<f64>,
) {
    #[cfg(target_arch = "x86_64")]
    if avx2::available() {
        return avx2::statistics_f64(pair, y, means, contrasts, scratch);
    }
    statistics::<Portable<f64, 2>>(pair, y, means, contrasts, scratch);
}

/// A picture to compare with, and the statistics of its windows.
#[derive(Debug, Clone)]
pub(super) struct Reference<T> {
    pub(super) width: usize,
    pub(super) height: usize,
    /// `[height, width, 3]`.
    values: Vec<f32>,
    /// The mean of the values.
    shift: f32,
    /// `[window rows][stride]`, see [`super::index::mean_and_contrast`].
    means: Vec<T>,
    contrasts: Vec<T>,
}

/// The mean, about; the same for the same values on any number of threads.
fn mean(values: &[f32]) -> f32 {
    // So that sums of blocks stay in the range of f32.
    const SCALE: f32 = 1.0 / 1024.0;
    let block = |block: &[f32]| -> f64 {
        let (vectors, rest) = block.as_chunks::<16>();
        let mut sums = [0.0; 16];
        for vector in vectors {
            for (sum, value) in sums.iter_mut().zip(vector) {
                *sum += SCALE * value;
            }
        }
        sums.into_iter().chain(rest.iter().map(|value| SCALE * value)).map(f64::from).sum()
    };
    let parts: Vec<f64> =
        values.par_chunks(1 << 14).map(|part| part.chunks(1 << 10).map(block).sum()).collect();
    (parts.iter().sum::<f64>() / (f64::from(SCALE) * values.len() as f64)) as f32
}

impl<T: Number> Reference<T> {
    /// From finite values `[height, width, 3]`, both sides at least [`SSIM_WINDOW`].
    pub(super) fn new(values: &[f32], width: usize, height: usize) -> Self {
        let shift = mean(values);
        // The moments of b - shift are those of the difference of b and a picture that is `shift` everywhere.
        let flat = vec![shift; values.len()];
        let pair = Pair { a: values, b: &flat, shift, offset: 0.0, width };
        let (stride, windows) = (stride(width), width * CHANNELS - REACH);
        // Beyond the end of a row stands what is so bright and of such contrast that no difference counts: the index and
        // its derivatives are exactly 0 there.
        let mut means = vec![T::HUGE; (height + 1 - SSIM_WINDOW) * stride];
        let mut contrasts = vec![T::INFINITY; means.len()];
        let block = ROWS * stride;
        means.par_chunks_mut(block).zip(contrasts.par_chunks_mut(block)).enumerate().for_each_init(
            || (Scratch::default(), vec![0.0; block], vec![0.0; block]),
            |(scratch, exact_means, exact_contrasts), (index, (means, contrasts))| {
                let length = means.len();
                let (exact_means, exact_contrasts) =
                    (&mut exact_means[..length], &mut exact_contrasts[..length]);
                statistics_f64(pair, index * ROWS, exact_means, exact_contrasts, scratch);
                for (numbers, exact) in [(means, exact_means), (contrasts, exact_contrasts)] {
                    for (numbers, exact) in numbers.chunks_mut(stride).zip(exact.chunks(stride)) {
                        for (number, &exact) in numbers.iter_mut().zip(&exact[..windows]) {
                            *number = T::nearest(exact);
                        }
                    }
                }
            },
        );
        Self { width, height, values: values.to_vec(), shift, means, contrasts }
    }

    /// 1 - SSIM of finite values of the same size.
    pub(super) fn loss(&self, a: &[f32]) -> f64 {
        let pair = self.pair(a);
        let rows = self.rows_of_a_band(ROWS);
        let mut sums = vec![0.0; self.height];
        sums.par_chunks_mut(rows).enumerate().for_each_init(Scratch::default, |scratch, (index, sums)| {
            T::band(self.band(pair, index * rows, 0.0), sums, &mut [], scratch);
        });
        self.mean(&sums)
    }

    /// As [`Self::loss`]; adds `weight` times the derivative by `a` to `gradient`.
    pub(super) fn loss_with_gradient(
        &self,
        a: &[f32],
        weight: f32,
        gradient: &mut [f32],
        scratch: &mut Vec<Scratch<T>>,
    ) -> f64 {
        // How the rows are shared out changes no bit of what is found in them.
        let rows = self.rows_of_a_band(FEWEST_ROWS);
        let pair = self.pair(a);
        let mut sums = vec![0.0; self.height];
        scratch.resize(scratch.len().max(self.height.div_ceil(rows)), Scratch::default());
        let weight = (f64::from(weight) / self.windows()) as f32;
        gradient
            .par_chunks_mut(rows * self.width * CHANNELS)
            .zip(sums.par_chunks_mut(rows))
            .zip(scratch)
            .enumerate()
            .for_each(|(index, ((gradient, sums), scratch))| {
                T::band(self.band(pair, index * rows, weight), sums, gradient, scratch);
            });
        self.mean(&sums)
    }

    fn rows_of_a_band(&self, fewest: usize) -> usize {
        let bands = 2 * rayon::current_num_threads();
        self.height.div_ceil(bands).next_multiple_of(ROWS).max(fewest)
    }

    fn pair<'a>(&'a self, a: &'a [f32]) -> Pair<'a> {
        let offset = (mean(a) - self.shift).clamp(f32::MIN, f32::MAX);
        Pair { a, b: &self.values, shift: self.shift, offset, width: self.width }
    }

    fn band<'a>(&'a self, pair: Pair<'a>, first: usize, weight: f32) -> Band<'a, T> {
        Band { pair, means: &self.means, contrasts: &self.contrasts, first, weight }
    }

    /// Windows of all channels.
    fn windows(&self) -> f64 {
        ((self.height + 1 - SSIM_WINDOW) * (self.width * CHANNELS - REACH)) as f64
    }

    /// In the order of the rows, so that the result does not depend on the number of threads.
    fn mean(&self, sums: &[f64]) -> f64 {
        sums.iter().sum::<f64>() / self.windows()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 83;
    const HEIGHT: usize = 61;
    const VALUES: usize = WIDTH * HEIGHT * CHANNELS;

    /// -½..½.
    fn noise(seed: u64) -> Vec<f32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        (0..VALUES).map(|_| next()).collect()
    }

    /// Name, picture, target.
    fn hard_cases() -> Vec<(&'static str, Vec<f32>, Vec<f32>)> {
        let (p, q) = (noise(1), noise(2));
        let make = |value: &dyn Fn(usize) -> f32| (0..VALUES).map(value).collect::<Vec<f32>>();
        // Shading, grain and a bright disc.
        let natural = make(&|i| {
            let (x, y) = ((i / 3 % WIDTH) as f32, (i / 3 / WIDTH) as f32);
            let disc = if (x - 40.0).hypot(y - 30.0) < 18.0 { 0.4 } else { 0.0 };
            0.45 + 0.3 * (x / 30.0).sin() * (y / 20.0).cos() + disc + 0.02 * p[i]
        });
        let n = &natural;
        let grey = |value: f32| vec![value; VALUES];
        let colour = |rgb: [f32; 3]| rgb.repeat(WIDTH * HEIGHT);
        let halves = |i: usize| if i < VALUES / 2 { 1.0 } else { 0.0 };
        vec![
            ("noise", make(&|i| n[i] + 0.1 * q[i]), n.clone()),
            ("little noise", make(&|i| n[i] + 2e-5 * q[i]), n.clone()),
            ("moved", make(&|i| n[(i + 3) % VALUES]), n.clone()),
            ("grey for a picture", grey(0.5), n.clone()),
            ("a picture for grey", n.clone(), grey(0.5)),
            ("black for a picture", grey(0.0), n.clone()),
            ("flat", grey(0.2), grey(0.7)),
            ("flat and bright", grey(0.98), grey(1.0)),
            ("flat and near", grey(0.9999), grey(1.0)),
            ("flat colours", colour([0.9, 0.1, 0.5]), colour([0.8, 0.3, 0.45])),
            ("bright grain", make(&|i| 0.99 + 1e-3 * q[i]), make(&|i| 0.99 + 1e-3 * p[i])),
            ("dull halves swapped", make(&|i| 0.9 - 0.6 * halves(i)), make(&|i| 0.3 + 0.6 * halves(i))),
            ("halves swapped", make(&|i| 1.0 - halves(i)), make(&halves)),
            ("grain on halves", make(&|i| halves(i) + 1e-3 * q[i]), make(&|i| halves(i) + 1e-3 * p[i])),
            ("far from 0", make(&|i| 1e4 + q[i]), make(&|i| 1e4 + p[i])),
            ("out of range", make(&|i| 6.0 * q[i]), make(&|i| 6.0 * p[i])),
            ("large", make(&|i| 1e5 * q[i]), make(&|i| 1e5 * p[i])),
            ("largest", make(&|i| 1e6_f32.copysign(q[i])), make(&|i| 1e6_f32.copysign(p[i]))),
        ]
    }

    fn largest(values: &[f32]) -> f32 {
        values.iter().fold(0.0, |largest, value| largest.max(value.abs()))
    }

    /// Loss and gradient, with the bands done by `band`.
    fn fit<T: Number>(
        a: &[f32],
        b: &[f32],
        band: impl Fn(Band<T>, &mut [f64], &mut [f32], &mut Scratch<T>),
    ) -> (f64, Vec<f32>) {
        let (mut sums, mut gradient) = (vec![0.0; HEIGHT], vec![0.0; VALUES]);
        let reference = Reference::<T>::new(b, WIDTH, HEIGHT);
        let work = reference.band(reference.pair(a), 0, 1.0 / reference.windows() as f32);
        band(work, &mut sums, &mut gradient, &mut Scratch::default());
        (reference.mean(&sums), gradient)
    }

    /// Largest deviation of the gradients, of the largest element.
    fn deviation(exact: &[f32], found: &[f32]) -> f32 {
        let off: Vec<f32> = exact.iter().zip(found).map(|(exact, found)| exact - found).collect();
        largest(&off) / largest(exact)
    }

    #[test]
    fn f32_is_near_f64() {
        for (case, a, b) in hard_cases() {
            let (exact, exact_gradient) = fit(&a, &b, f64::band);
            let found = [fit(&a, &b, f32::band), fit(&a, &b, band::<Portable<f32, 4>>)];
            for (vectors, (loss, gradient)) in ["best", "portable"].iter().zip(found) {
                assert!((loss - exact).abs() < 1e-5, "{case}, {vectors}: {loss} for {exact}");
                // Where both pictures are flat and far apart, every window rounds the same variance of nothing.
                let bound = if case.ends_with("halves swapped") { 4e-4 } else { 1e-4 };
                let off = deviation(&exact_gradient, &gradient);
                assert!(off < bound, "{case}, {vectors}: the gradient is off by {off:e} of its largest");
            }
        }
    }

    #[test]
    fn bands_and_vectors_change_nothing_in_f64() {
        for (case, a, b) in hard_cases() {
            let (exact, exact_gradient) = fit(&a, &b, band::<Portable<f64, 2>>);
            let reference = Reference::<f64>::new(&b, WIDTH, HEIGHT);
            let mut gradient = vec![0.0; VALUES];
            let loss = reference.loss_with_gradient(&a, 1.0, &mut gradient, &mut Vec::new());
            assert_eq!(loss, reference.loss(&a), "{case}");
            assert!((loss - exact).abs() < 1e-12, "{case}: {loss} for {exact}");
            let off = deviation(&exact_gradient, &gradient);
            assert!(off < 1e-6, "{case}: the gradient is off by {off:e} of its largest");
        }
    }
}
