use crate::hilbert::hilbert_order;
use crate::random::Stream;
use crate::{Error, ImportanceMap, Probability, Result, solve};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How many pixels to choose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// This many over all views together: tau is solved for it.
    Count(usize),
    /// As many as the paper's rule gives with this tau.
    Tau(f64),
}

/// How pixels are drawn. Both give every pixel the same probability.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// Systematic sampling along a Hilbert curve through each view: the count is the budget exactly (with a tau: the
    /// expected count rounded up or down), and so it is, up to rounding, in every part of a view.
    #[default]
    Fixed,
    /// Independent draws, the paper's: the count varies around the budget.
    Bernoulli,
}

/// Chosen pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// Per view: indices (row-major) of the chosen pixels, ascending.
    pub pixels: Vec<Vec<u32>>,
    /// The rule they were drawn by.
    pub probability: Probability,
    /// Expected count: the sum of all probabilities.
    pub expected: f64,
}

impl Samples {
    /// Number of chosen pixels over all views.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pixels.iter().map(Vec::len).sum()
    }
}

/// Chooses pixels of several views together. The same input and seed give the same pixels on any number of threads.
///
/// With [`Budget::Count`], [`Sampler::Fixed`] returns exactly that many pixels, or every pixel of weight above 0 if
/// they are fewer.
///
/// # Errors
/// If the budget is a count of 0 or a tau that is not a finite number above 0, there are no maps, or a count is asked
/// for and every pixel has weight 0.
pub fn sample(maps: &[ImportanceMap], budget: Budget, sampler: Sampler, seed: u64) -> Result<Samples> {
    let probability = match budget {
        Budget::Count(0) => return Err(Error::EmptyBudget),
        Budget::Count(count) => solve(maps, count as f64)?,
        Budget::Tau(tau) => Probability::from_tau(tau)?,
    };
    if maps.is_empty() {
        return Err(Error::NoMaps);
    }
    let pixels = match sampler {
        Sampler::Bernoulli => bernoulli(maps, &probability, seed),
        Sampler::Fixed => {
            let count = match budget {
                Budget::Count(count) => Some(count),
                Budget::Tau(_) => None,
            };
            fixed(maps, &probability, count, seed)
        }
    };
    Ok(Samples { pixels, probability, expected: probability.expected(maps) })
}

fn bernoulli(maps: &[ImportanceMap], probability: &Probability, seed: u64) -> Vec<Vec<u32>> {
    (1..)
        .zip(maps)
        .map(|(stream, map)| {
            let draws = Stream::new(seed, stream);
            let pixels = map.values().par_iter().enumerate().with_min_len(1 << 13);
            pixels
                .filter(|&(pixel, &value)| {
                    draws.uniform(pixel as u64) < probability.of(value, map.weight(pixel))
                })
                .map(|(pixel, _)| pixel as u32)
                .collect()
        })
        .collect()
}

/// Probability 1 in the integers that [`fixed`] sums.
const ONE: u32 = 1 << 31;

/// Lays the probabilities of all pixels end to end, along the Hilbert curve of each view and view after view, and
/// takes the pixels in which the points u, u + 1, u + 2 … fall, for one random u. Sums are integers, hence exact.
fn fixed(
    maps: &[ImportanceMap],
    probability: &Probability,
    count: Option<usize>,
    seed: u64,
) -> Vec<Vec<u32>> {
    let mut lengths: Vec<Vec<u32>> = maps
        .iter()
        .map(|map| {
            let pixels = map.values().par_iter().enumerate().with_min_len(1 << 13);
            pixels
                .map(|(pixel, &value)| {
                    (probability.of(value, map.weight(pixel)) * f64::from(ONE)).round() as u32
                })
                .collect()
        })
        .collect();
    if let Some(count) = count {
        close_rounding_gap(&mut lengths, maps, count);
    }
    let mut sizes: Vec<(usize, usize)> = maps.iter().map(|map| (map.width(), map.height())).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let orders: Vec<Vec<u32>> = sizes.iter().map(|&(w, h)| hilbert_order(w, h)).collect();

    let totals: Vec<u64> = lengths.par_iter().map(|view| total(view)).collect();
    let starts: Vec<u64> = totals
        .iter()
        .scan(0, |end, total| {
            *end += total;
            Some(*end - total)
        })
        .collect();
    let offset = Stream::new(seed, 0).bits(0) % u64::from(ONE);
    let views = maps.par_iter().zip(&lengths).zip(starts);
    views
        .map(|((map, lengths), start)| {
            let size = (map.width(), map.height());
            let order = &orders[sizes.partition_point(|&other| other < size)];
            let mut chosen = Vec::new();
            // The distance from the start of a pixel to the next point, which is always less than ONE away.
            let one = u64::from(ONE);
            let mut to_next = (offset + one - start % one) % one;
            for &pixel in order {
                let length = u64::from(lengths[pixel as usize]);
                if to_next < length {
                    chosen.push(pixel);
                    to_next += one;
                }
                to_next -= length;
            }
            chosen.sort_unstable();
            chosen
        })
        .collect()
}

fn total(lengths: &[u32]) -> u64 {
    lengths.iter().map(|&length| u64::from(length)).sum()
}

/// Rounding to integers moved the sum away from `count`, by a fraction of a unit per pixel: moves it back, by a unit
/// or so (2^-31 of probability) on pixels that are neither certain nor impossible.
fn close_rounding_gap(lengths: &mut [Vec<u32>], maps: &[ImportanceMap], count: usize) {
    let usable: usize = maps
        .iter()
        .map(|map| map.weights().map_or(map.values().len(), |w| w.iter().filter(|&&w| w > 0.0).count()))
        .sum();
    let target = count.min(usable) as i128 * i128::from(ONE);
    let sum: u64 = lengths.iter().map(|view| total(view)).sum();
    let mut gap = target - i128::from(sum);
    while gap != 0 {
        let open = |length: &u32| (1..ONE).contains(length);
        let mut n_open = lengths.iter().flatten().filter(|length| open(length)).count() as i128;
        assert!(n_open > 0, "{gap} units of 2^-31 are missing and no pixel can take them");
        for length in lengths.iter_mut().flatten().filter(|length| open(length)) {
            // An even share of what is left, rounded away from 0.
            let share = (gap + gap.signum() * (n_open - 1)) / n_open;
            let moved = (i128::from(*length) + share).clamp(0, i128::from(ONE));
            gap -= moved - i128::from(*length);
            *length = moved as u32;
            n_open -= 1;
            if gap == 0 {
                return;
            }
        }
    }
}
