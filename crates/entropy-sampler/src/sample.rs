use crate::blue_noise::Thresholds;
use crate::random::Stream;
use crate::{Error, ImportanceMap, Probability, Result, fixed, parallel, solve};

/// How many pixels to choose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Budget {
    /// This many over all views together: tau is solved for it.
    Count(usize),
    /// As many as the paper's rule gives with this tau.
    Tau(f64),
}

/// How pixels are drawn. All give every pixel the same probability.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Sampler {
    /// Spread evenly by blue-noise thresholds, and in an exact number: the count is the budget (with a tau: the
    /// expected count rounded up or down), and so is, up to rounding, the count of every view.
    #[default]
    Fixed,
    /// Independent draws, the paper's: the count varies around the budget.
    Bernoulli,
    /// In an exact number, one after the other along a Hilbert curve. Where pixels are alike, every aligned cell of 2x2 pixels, of 4x4 and
    /// so on holds as many as every other, or one more. Views that are alike may get the same pixels.
    Systematic,
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
    /// For each chosen pixel: the share of its probability, in 0..1, from which on it would be chosen.
    shares: Vec<Vec<f32>>,
}

impl Samples {
    /// Number of chosen pixels over all views.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pixels.iter().map(Vec::len).sum()
    }

    /// The chosen pixels of all views as (view, pixel), in an order whose every beginning is itself a good sample: the
    /// first n of N have the probabilities n / N · P, and are spread as those of the sampler are.
    #[must_use]
    pub fn progressive(&self) -> Vec<(usize, u32)> {
        let mut order = Vec::with_capacity(self.count());
        for (view, (pixels, shares)) in self.pixels.iter().zip(&self.shares).enumerate() {
            order.extend(pixels.iter().zip(shares).map(|(&pixel, &share)| (share, view, pixel)));
        }
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        order.into_iter().map(|(_, view, pixel)| (view, pixel)).collect()
    }
}

/// Chooses pixels of several views together. The same input and seed give the same pixels on any number of threads.
///
/// With [`Budget::Count`], all but [`Sampler::Bernoulli`] return exactly that many pixels, or every pixel of weight above 0 if
/// they are fewer.
///
/// # Errors
/// If the budget is a count of 0 or a tau that is not a finite number above 0, there are no maps, or a count is asked
/// for and every pixel has weight 0.
pub fn sample(maps: &[ImportanceMap], budget: Budget, sampler: Sampler, seed: u64) -> Result<Samples> {
    let (probability, count) = match budget {
        Budget::Count(0) => return Err(Error::EmptyBudget),
        Budget::Count(count) => (solve(maps, count as f64)?, Some(count)),
        Budget::Tau(tau) => (Probability::from_tau(tau)?, None),
    };
    if maps.is_empty() {
        return Err(Error::NoMaps);
    }
    let draw = Draw { probability, count, sampler, seed };
    Ok(draw.samples(maps, 0))
}

/// Chooses pixels of each view for a count of its own, with a tau of its own: one [`Samples`] of one view for each
/// map, by the rules of [`sample`]. A view whose count is 0, or of whose pixels none has weight, gives none.
///
/// # Errors
/// If there are no maps, or not one count for each; if all counts are 0; if every pixel of every view has weight 0.
pub fn sample_per_view(
    maps: &[ImportanceMap],
    counts: &[usize],
    sampler: Sampler,
    seed: u64,
) -> Result<Vec<Samples>> {
    if maps.is_empty() {
        return Err(Error::NoMaps);
    }
    if counts.len() != maps.len() {
        return Err(Error::Counts { expected: maps.len(), found: counts.len() });
    }
    if counts.iter().all(|&count| count == 0) {
        return Err(Error::EmptyBudget);
    }
    if maps.iter().all(|map| map.usable() == 0) {
        return Err(Error::NoUsablePixel);
    }
    let nothing = Probability { tau: 0.0, flat: 0.0, lift: 1.0 };
    parallel::map(maps.len(), |view| {
        let map = std::slice::from_ref(&maps[view]);
        let count = counts[view].min(map[0].usable());
        let probability = if count == 0 { nothing } else { solve(map, count as f64)? };
        let draw = Draw { probability, count: Some(count), sampler, seed };
        Ok(draw.samples(map, view as u64))
    })
    .into_iter()
    .collect()
}

/// What is drawn, and how.
struct Draw {
    probability: Probability,
    /// The exact count, if one was asked for.
    count: Option<usize>,
    sampler: Sampler,
    seed: u64,
}

impl Draw {
    /// `first_view` is the number of the first of these views among those that are drawn with the same seed.
    fn samples(&self, maps: &[ImportanceMap], first_view: u64) -> Samples {
        let stream = |purpose: u64, view: usize| Stream::new(self.seed, purpose + first_view + view as u64);
        let thresholds = |view| Thresholds::new(stream(THRESHOLDS, view));
        let pixels = match self.sampler {
            Sampler::Fixed => {
                let dither = |view| Some(thresholds(view));
                fixed::draw(maps, &self.probability, self.count, stream(SYSTEMATIC, 0), dither)
            }
            Sampler::Systematic => {
                fixed::draw(maps, &self.probability, self.count, stream(SYSTEMATIC, 0), |_| None)
            }
            Sampler::Bernoulli => parallel::map(maps.len(), |view| {
                let (map, draws) = (&maps[view], stream(INDEPENDENT, view));
                let pixels = 0..map.values().len() as u32;
                pixels.filter(|&pixel| draws.uniform(u64::from(pixel)) < self.p(map, pixel)).collect()
            }),
        };
        let shares = parallel::map(maps.len(), |view| {
            let (map, draws, thresholds) = (&maps[view], stream(INDEPENDENT, view), thresholds(view));
            let share = |&pixel: &u32| {
                let (x, y) = (pixel as usize % map.width(), pixel as usize / map.width());
                let (p, uniform) = (self.p(map, pixel), draws.uniform(u64::from(pixel)));
                let threshold = f64::from(thresholds.at(x, y)) / f64::from(1u32 << Thresholds::BITS);
                let share = match self.sampler {
                    Sampler::Bernoulli => uniform / p,
                    Sampler::Fixed if threshold < p => threshold / p,
                    // Not chosen by the thresholds, but for the exact count: at any place.
                    Sampler::Fixed | Sampler::Systematic => uniform,
                };
                share as f32
            };
            pixels[view].iter().map(share).collect()
        });
        let expected = self.probability.expected(maps);
        Samples { pixels, probability: self.probability, expected, shares }
    }

    /// P of a pixel.
    fn p(&self, map: &ImportanceMap, pixel: u32) -> f64 {
        self.probability.of(map.values()[pixel as usize], map.weight(pixel as usize))
    }
}

/// Streams of random numbers; the number of a view is added.
const INDEPENDENT: u64 = 0;
const THRESHOLDS: u64 = 1 << 32;
const SYSTEMATIC: u64 = 2 << 32;
