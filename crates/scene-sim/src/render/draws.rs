//! Numbers for the samples of a pixel: evenly spread over its samples, different from pixel to pixel.

use crate::noise::{hash, unit};
use glam::DVec2;

/// Identifies a sample; nothing is computed before a number is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draws {
    pub(super) pixel: [u32; 2],
    /// Which of the samples of the pixel, and the columns and rows of their grid.
    pub(super) index: u32,
    pub(super) strata: [u32; 2],
    pub(super) seed: u32,
}

/// What numbers are for: each has its own.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Sun,
    Occlusion,
    Aperture,
    Moment,
    Lamp(u32),
}

impl Purpose {
    fn code(self) -> u32 {
        match self {
            Self::Sun => 0x51,
            Self::Occlusion => 0x52,
            Self::Aperture => 0x53,
            Self::Moment => 0x54,
            Self::Lamp(index) => index.wrapping_add(0x100),
        }
    }
}

impl Draws {
    /// A point of the unit square. Those of all samples of the pixel fill it evenly, in an order that has nothing to do
    /// with where in the pixel the samples lie.
    pub(super) fn point(&self, purpose: Purpose) -> DVec2 {
        let bits = self.bits(purpose);
        let [columns, rows] = self.strata;
        jittered(permuted(self.index, columns * rows, bits), self.strata, bits)
    }

    /// As [`Draws::point`], with `parts` points for this sample.
    pub(super) fn points(self, purpose: Purpose, parts: u32) -> impl Iterator<Item = DVec2> {
        let bits = self.bits(purpose);
        let columns = self.strata[0] * self.strata[1];
        let column = permuted(self.index, columns, bits);
        (0..parts).map(move |part| jittered(part * columns + column, [columns, parts], bits))
    }

    fn bits(&self, purpose: Purpose) -> u32 {
        hash(self.pixel[0], self.pixel[1], purpose.code(), self.seed)
    }

    /// The numbers of a ray that follows this one.
    pub(super) fn next(self, branch: u32) -> Self {
        Self { seed: hash(branch, 0x61, 0, self.seed), ..self }
    }
}

/// A place in cell `index` of a grid of columns and rows on the unit square: at random, but so that all of them have
/// different x and y even on a grid with a column, and one with a row, for each of them (A. Kensler, "Correlated
/// Multi-Jittered Sampling", 2013).
fn jittered(index: u32, [columns, rows]: [u32; 2], bits: u32) -> DVec2 {
    let (column, row) = (index % columns, index / columns);
    let seed = hash(index, 1, 0x62, bits);
    let jitter = DVec2::new(unit(seed), unit(hash(seed, 2, 0x62, bits)));
    let within = DVec2::new(
        f64::from(permuted(row, rows, hash(bits, 3, 0x62, 0))) + jitter.x,
        f64::from(permuted(column, columns, hash(bits, 4, 0x62, 0))) + jitter.y,
    );
    let (columns, rows) = (f64::from(columns), f64::from(rows));
    DVec2::new((f64::from(column) + within.x / rows) / columns, (f64::from(row) + within.y / columns) / rows)
}

/// Where `index` of 0..count goes in one of many shuffled orders.
fn permuted(index: u32, count: u32, order: u32) -> u32 {
    let bits = 32 - (count.max(2) - 1).leading_zeros();
    let (mask, half) = ((1u32 << bits) - 1, bits.div_ceil(2));
    let mut index = index;
    // Each step is one-to-one on 0..=mask; walking on along the cycle until it is back in 0..count is, too.
    loop {
        index = index.wrapping_mul(order >> 8 | 1).wrapping_add(order) & mask;
        index ^= index >> half;
        index = index.wrapping_mul(0x9e37_79b1 ^ (order & !1)).wrapping_add(order >> 16) & mask;
        index ^= index >> half;
        if index < count {
            return index;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_has_a_place_of_its_own() {
        for count in [1, 2, 3, 4, 7, 9, 16, 100, 4096] {
            for order in 0..50 {
                let order = hash(order, 3, 3, 3);
                let mut places: Vec<u32> = (0..count).map(|i| permuted(i, count, order)).collect();
                places.sort_unstable();
                assert!(places.iter().copied().eq(0..count), "{count} samples, order {order:x}");
            }
        }
    }

    #[test]
    fn points_fill_the_square_more_evenly_than_chance() {
        for (strata, parts) in [([4, 4], 1), ([7, 1], 1), ([3, 3], 4), ([1, 1], 9)] {
            let count = strata[0] * strata[1];
            let mut error = 0.0;
            let pixels = 400;
            for pixel in 0..pixels {
                let draws = |index| Draws { pixel: [pixel, 9], index, strata, seed: 4 };
                let points: Vec<DVec2> = (0..count)
                    .flat_map(|index| match parts {
                        1 => vec![draws(index).point(Purpose::Lamp(2))],
                        _ => draws(index).points(Purpose::Occlusion, parts).collect(),
                    })
                    .collect();
                let n = points.len() as u32;
                for values in
                    [points.iter().map(|p| p.x).collect::<Vec<_>>(), points.iter().map(|p| p.y).collect()]
                {
                    let mut cells: Vec<u32> = values.iter().map(|v| (v * f64::from(n)) as u32).collect();
                    cells.sort_unstable();
                    assert!(cells.iter().copied().eq(0..n), "{cells:?}");
                }
                let mean = points.iter().map(|p| p.x * p.y).sum::<f64>() / f64::from(n);
                error += (mean - 0.25).powi(2) / f64::from(pixels);
            }
            // Variance of the mean of x y by chance.
            let chance = 7.0 / 144.0 / f64::from(count * parts);
            assert!(error < 0.35 * chance, "{error} of {chance}, {count} samples");
        }
    }
}
