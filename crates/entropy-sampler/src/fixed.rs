//! Exactly as many pixels as expected, each with its probability P, and no two close to each other without need.
//!
//! Blue-noise thresholds T choose the pixels with T < P: spread as evenly as can be, each with probability P, but not
//! exactly as many as expected. With I = 1 for those and 0 for others, hence of mean P, and X = Σ (I - P) the number
//! that is too many, let
//!
//! Q = P + κ (I - P - X · P (1 - P) / V),   V = Σ P (1 - P),   κ = 1 / (1 + B / V).
//!
//! X is 0 in the mean, so that Q has the mean P; the sum of Q is that of P in every draw; and Q lies in 0..1 as long as
//! |X| ≤ B. It is 0 or 1 but for about B / V. What is left open is drawn from Q by systematic sampling along a Hilbert
//! curve, which takes every pixel with probability Q, hence P altogether, and exactly ΣQ = ΣP of them.
//!
//! B = 2 √V + 8, or less where |X| cannot be that large. Independent draws would give X the standard deviation √V; by
//! the thresholds it was 0.2 √V to 0.4 √V on photographs, and one in 40 of 6,700 chosen pixels is left open. Where |X| is
//! above B all the same, κ is that of B = |X|, and P not quite met. It takes a picture whose only important pixels, more
//! than some ten of them, are 64 apart, the period of the thresholds, to see it.

use crate::blue_noise::Thresholds;
use crate::hilbert::hilbert_order;
use crate::random::Stream;
use crate::{ImportanceMap, Probability, parallel};

/// Probability 1 in the integers that are summed: exactly, whatever the order.
const ONE: u32 = 1 << Thresholds::BITS;

/// Chosen pixels of each view, ascending. `count`, if one was asked for, is exact; `systematic` and `thresholds` (by
/// view) are the random numbers. Without thresholds Q is P: systematic sampling alone.
pub(crate) fn draw(
    maps: &[ImportanceMap],
    probability: &Probability,
    count: Option<usize>,
    systematic: Stream,
    thresholds: impl Fn(usize) -> Option<Thresholds> + Sync + Send,
) -> Vec<Vec<u32>> {
    let mut lengths = parallel::map(maps.len(), |view| lengths(&maps[view], probability, thresholds(view)));
    if let Some(count) = count {
        close_rounding_gap(&mut lengths, maps, count);
    }
    let mut sizes: Vec<(usize, usize)> = maps.iter().map(|map| (map.width(), map.height())).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let orders: Vec<Vec<u32>> = parallel::map(sizes.len(), |i| hilbert_order(sizes[i].0, sizes[i].1));

    let one = u64::from(ONE);
    // The probabilities of all pixels end to end, along the curve of each view and view after view: the pixels are
    // chosen in which the points u, u + 1, u + 2 … fall, for one random u.
    let mut first_point = systematic.bits(0) % one;
    let mut first_points = Vec::with_capacity(maps.len());
    for lengths in &lengths {
        first_points.push(first_point);
        first_point = (first_point + one - total(lengths) % one) % one;
    }
    parallel::map(maps.len(), |view| {
        let size = (maps[view].width(), maps[view].height());
        let order = &orders[sizes.partition_point(|&other| other < size)];
        let mut chosen = Vec::new();
        // The distance from the start of a pixel to the next point, which is always less than ONE away.
        let mut to_next = first_points[view];
        for &pixel in order {
            let length = u64::from(lengths[view][pixel as usize]);
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

/// Q of each pixel, in units of 1 / [`ONE`].
fn lengths(map: &ImportanceMap, probability: &Probability, thresholds: Option<Thresholds>) -> Vec<u32> {
    let Some(thresholds) = thresholds else {
        let p = |(pixel, &value)| probability.of(value, map.weight(pixel));
        return map.values().iter().enumerate().map(p).map(|p| (p * f64::from(ONE) + 0.5) as u32).collect();
    };
    let width = map.width();
    let one = f64::from(ONE);
    let mut lengths = vec![0u32; map.values().len()];
    // `most` is more than the surplus can be.
    let (mut variance, mut most, mut surplus) = (0.0, 0.0, 0i64);
    for (y, (lengths, values)) in
        lengths.chunks_exact_mut(width).zip(map.values().chunks_exact(width)).enumerate()
    {
        for (x, (length, &value)) in lengths.iter_mut().zip(values).enumerate() {
            let p = probability.of(value, map.weight(y * width + x));
            *length = (p * one + 0.5) as u32;
            variance += p * (1.0 - p);
            most += if p > 0.0 && p < 1.0 { p.max(1.0 - p) } else { 0.0 };
            let is_chosen = thresholds.at(x, y) < *length;
            surplus += i64::from(is_chosen) * i64::from(ONE) - i64::from(*length);
        }
    }
    if variance > 0.0 {
        let surplus = surplus as f64 / one;
        let bound = surplus.abs().max(most.min(2.0 * variance.sqrt() + 8.0));
        let kappa = 1.0 / (1.0 + bound / variance);
        let shift = surplus / variance;
        for (y, lengths) in lengths.chunks_exact_mut(width).enumerate() {
            for (x, length) in lengths.iter_mut().enumerate() {
                let p = f64::from(*length) / one;
                let is_chosen = f64::from(u8::from(thresholds.at(x, y) < *length));
                let q = p + kappa * (is_chosen - p - shift * p * (1.0 - p));
                *length = ((q * one + 0.5) as u32).min(ONE);
            }
        }
    }
    lengths
}

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
