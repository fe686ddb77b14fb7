//! Random numbers for scenes: a sequence that depends on its seed alone.

use crate::Rgb;
use crate::noise::{hash, unit};

/// A sequence of random numbers that depends on the seed alone.
pub(crate) struct Random {
    seed: u32,
    drawn: u32,
}

impl Random {
    /// `stream` keeps the uses of one seed apart.
    pub(crate) fn new(seed: u64, stream: u32) -> Self {
        Self { seed: hash(seed as u32, (seed >> 32) as u32, stream, 1), drawn: 0 }
    }

    pub(crate) fn bits(&mut self) -> u32 {
        self.drawn += 1;
        hash(self.drawn, 0, 0, self.seed)
    }

    pub(crate) fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * unit(self.bits())
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        unit(self.bits()) < probability
    }

    /// A colour of a brightness in 0..1, greyish or strong.
    pub(crate) fn colour(&mut self, brightness: f64) -> Rgb {
        let hue = self.within(0.0, std::f64::consts::TAU);
        let strength = self.within(0.03, 0.22);
        // Three cosines a third of a turn apart: the channels sum to three times the brightness.
        [0.0, 1.0, 2.0].map(|third: f64| {
            let wave = (hue + third * std::f64::consts::TAU / 3.0).cos();
            (brightness + strength * wave).clamp(0.02, 0.98) as f32
        })
    }

    /// A light and a dark colour.
    pub(crate) fn colours(&mut self) -> [Rgb; 2] {
        let (light, dark) = (self.within(0.6, 0.85), self.within(0.15, 0.4));
        [self.colour(light), self.colour(dark)]
    }
}

impl Random {
    /// A whole number of `low..=high`.
    pub(crate) fn count(&mut self, low: u32, high: u32) -> u32 {
        low + self.bits() % (high - low + 1)
    }

    /// Puts things into another order (Fisher and Yates).
    pub(crate) fn shuffle<T>(&mut self, things: &mut [T]) {
        for k in (1..things.len()).rev() {
            things.swap(k, self.count(0, k as u32) as usize);
        }
    }

    /// One of the choices.
    pub(crate) fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.bits() as usize % choices.len()]
    }

    /// A colour whose channels are each up to `spread` away from the given one.
    pub(crate) fn near(&mut self, colour: Rgb, spread: f64) -> Rgb {
        let shift = self.within(-spread, spread);
        colour.map(|c| (f64::from(c) + shift + 0.3 * self.within(-spread, spread)).clamp(0.01, 0.99) as f32)
    }
}
