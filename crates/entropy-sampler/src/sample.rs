use crate::hilbert::{self, hilbert_order};
use crate::random::Stream;
use crate::{Error, ImportanceMap, Probability, Result, parallel, solve};

/// How many pixels to choose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Budget {
    /// This many over all views together: tau is solved for it.
    Count(usize),
    /// As many as the paper's rule gives with this tau.
    Tau(f64),
}

/// How pixels are drawn. Both give every pixel the same probability.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
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
    /// Width and height of each view.
    sizes: Vec<(usize, usize)>,
}

impl Samples {
    /// Number of chosen pixels over all views.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pixels.iter().map(Vec::len).sum()
    }

    /// The chosen pixels of all views as (view, pixel) in an order whose every beginning is itself a good sample:
    /// the first n of N have the probabilities n / N · P, and are spread nearly as well as n drawn at once. Which of
    /// them comes first depends on `seed`.
    ///
    /// The order is that of the van der Corput sequence (bits reversed) of the place along the Hilbert curves.
    #[must_use]
    pub fn progressive(&self, seed: u64) -> Vec<(usize, u32)> {
        let mut along: Vec<(usize, u32)> = Vec::with_capacity(self.count());
        for (view, (pixels, &(width, height))) in self.pixels.iter().zip(&self.sizes).enumerate() {
            let mut placed: Vec<(u64, u32)> =
                pixels.iter().map(|&pixel| (hilbert::place(pixel, width, height), pixel)).collect();
            placed.sort_unstable();
            along.extend(placed.into_iter().map(|(_, pixel)| (view, pixel)));
        }
        let count = along.len() as u64;
        if count < 2 {
            return along;
        }
        // Turned by a random number of places, each chosen pixel is as likely as any other to be among the first n.
        let turn = Stream::new(seed, PROGRESSIVE).bits(0) % count;
        let bits = (count - 1).ilog2() + 1;
        (0..1u64 << bits)
            .map(|i| i.reverse_bits() >> (u64::BITS - bits))
            .filter(|&place| place < count)
            .map(|place| along[((place + turn) % count) as usize])
            .collect()
    }
}

/// Streams of random numbers: view v has 1 + v for independent draws and [`PER_VIEW`] + v where it has a budget of its
/// own.
const ALL_VIEWS: u64 = 0;
const PER_VIEW: u64 = 1 << 32;
const PROGRESSIVE: u64 = 1 << 33;

/// Chooses pixels of several views together. The same input and seed give the same pixels on any number of threads.
///
/// With [`Budget::Count`], [`Sampler::Fixed`] returns exactly that many pixels, or every pixel of weight above 0 if
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
    Ok(draw.samples(maps, 1, ALL_VIEWS))
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
        Ok(draw.samples(map, 1 + view as u64, PER_VIEW + view as u64))
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
    /// `bernoulli` is the first view's stream of random numbers, `fixed` that of all.
    fn samples(&self, maps: &[ImportanceMap], bernoulli: u64, fixed: u64) -> Samples {
        Samples {
            pixels: match self.sampler {
                Sampler::Bernoulli => self.bernoulli(maps, bernoulli),
                Sampler::Fixed => self.fixed(maps, Stream::new(self.seed, fixed)),
            },
            probability: self.probability,
            expected: self.probability.expected(maps),
            sizes: maps.iter().map(|map| (map.width(), map.height())).collect(),
        }
    }

    fn bernoulli(&self, maps: &[ImportanceMap], stream: u64) -> Vec<Vec<u32>> {
        let of = |view: usize| {
            let (map, draws) = (&maps[view], Stream::new(self.seed, stream + view as u64));
            let is_chosen = |&pixel: &u32| {
                let p = self.probability.of(map.values()[pixel as usize], map.weight(pixel as usize));
                draws.uniform(u64::from(pixel)) < p
            };
            (0..map.values().len() as u32).filter(is_chosen).collect()
        };
        parallel::map(maps.len(), of)
    }

    /// Lays the probabilities of all pixels end to end, along the Hilbert curve of each view and view after view, and
    /// takes the pixels in which the points u, u + 1, u + 2 … fall, for one random u. Sums are integers, hence exact.
    fn fixed(&self, maps: &[ImportanceMap], stream: Stream) -> Vec<Vec<u32>> {
        let mut lengths: Vec<Vec<u32>> = parallel::map(maps.len(), |view| {
            let map = &maps[view];
            let length = |(pixel, &value): (usize, &f32)| {
                (self.probability.of(value, map.weight(pixel)) * f64::from(ONE)).round() as u32
            };
            map.values().iter().enumerate().map(length).collect()
        });
        if let Some(count) = self.count {
            close_rounding_gap(&mut lengths, maps, count);
        }
        let mut sizes: Vec<(usize, usize)> = maps.iter().map(|map| (map.width(), map.height())).collect();
        sizes.sort_unstable();
        sizes.dedup();
        let orders: Vec<Vec<u32>> = sizes.iter().map(|&(w, h)| hilbert_order(w, h)).collect();

        let starts: Vec<u64> = lengths
            .iter()
            .scan(0, |end, lengths| {
                let start = *end;
                *end += total(lengths);
                Some(start)
            })
            .collect();
        let one = u64::from(ONE);
        let offset = stream.bits(0) % one;
        parallel::map(maps.len(), |view| {
            let size = (maps[view].width(), maps[view].height());
            let order = &orders[sizes.partition_point(|&other| other < size)];
            let lengths = &lengths[view];
            let mut chosen = Vec::new();
            // The distance from the start of a pixel to the next point, which is always less than ONE away.
            let mut to_next = (offset + one - starts[view] % one) % one;
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
    }
}

/// Probability 1 in the integers that [`Draw::fixed`] sums.
const ONE: u32 = 1 << 31;

fn total(lengths: &[u32]) -> u64 {
    lengths.iter().map(|&length| u64::from(length)).sum()
}

/// Rounding to integers moved the sum away from `count`, by a fraction of a unit per pixel: moves it back, by a unit
/// or so (2^-31 of probability) on pixels that are neither certain nor impossible.
fn close_rounding_gap(lengths: &mut [Vec<u32>], maps: &[ImportanceMap], count: usize) {
    let usable: usize = maps.iter().map(ImportanceMap::usable).sum();
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
