//! Numbers for the samples of a pixel: evenly spread over its samples, different from pixel to pixel.

use crate::noise::{hash, unit};
use glam::DVec2;

/// Identifies a sample; nothing is computed before a number is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Draws {
    pub(super) pixel: [u32; 2],
    /// Which of the samples of the pixel, and how many there are.
    pub(super) index: u32,
    pub(super) count: u32,
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

/// One over the plastic number, and its square: the additive recurrence with these steps fills the unit square evenly
/// (M. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
const STEPS: DVec2 = DVec2::new(0.754_877_666_246_692_7, 0.569_840_290_998_053_3);

impl Draws {
    /// A point of the unit square; those of all samples of the pixel fill it evenly, in an order that has nothing to
    /// do with where in the pixel the samples lie.
    pub(super) fn point(&self, purpose: Purpose) -> DVec2 {
        self.points(purpose, 1).next().unwrap_or_default()
    }

    /// As [`Draws::point`], with `parts` points for this sample.
    pub(super) fn points(&self, purpose: Purpose, parts: u32) -> impl Iterator<Item = DVec2> {
        let bits = hash(self.pixel[0], self.pixel[1], purpose.code(), self.seed);
        let shift = DVec2::new(unit(bits), unit(hash(bits, 1, 0, self.seed)));
        let first = f64::from(permuted(self.index, self.count, bits)) * f64::from(parts);
        (0..parts).map(move |part| (shift + STEPS * (first + f64::from(part))).fract())
    }

    /// The numbers of a ray that follows this one.
    pub(super) fn next(self, branch: u32) -> Self {
        Self { seed: hash(branch, 0x61, 0, self.seed), ..self }
    }
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
        // Variance of the mean of x y (1/4) over 16 samples: chance gives 7 / 144 / 16.
        let mut error = 0.0;
        let pixels = 400;
        for pixel in 0..pixels {
            let draws = |index| Draws { pixel: [pixel, 9], index, count: 16, seed: 4 };
            let points = (0..16).map(|index| draws(index).point(Purpose::Lamp(2)));
            let mean = points.map(|p| p.x * p.y).sum::<f64>() / 16.0;
            error += (mean - 0.25).powi(2) / f64::from(pixels);
        }
        let chance: f64 = 7.0 / 144.0 / 16.0;
        assert!(error < 0.2 * chance, "{error} of {chance}");
    }
}
