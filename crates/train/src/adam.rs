//! Adam (Kingma & Ba 2015) and its schedule.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// How fast weights move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rates {
    /// Largest learning rate (paper: 2e-4).
    pub learning_rate: f64,
    /// Steps over which it rises from 0.
    pub warm_up: usize,
    /// What is left of it at the last step, as a share; between, half a cosine.
    pub last: f64,
    /// Gradients longer than this are shortened to it.
    pub clip: f32,
}

impl Default for Rates {
    fn default() -> Self {
        Self { learning_rate: 1e-3, warm_up: 100, last: 0.01, clip: 1.0 }
    }
}

impl Rates {
    /// Whether every one is within its range.
    pub(crate) fn check(&self) -> Result<()> {
        let &Self { learning_rate, last, clip, .. } = self;
        let sound = learning_rate > 0.0 && learning_rate < 1.0 && (0.0..=1.0).contains(&last);
        if sound && clip > 0.0 && clip.is_finite() {
            return Ok(());
        }
        Err(Error::Setting {
            setting: "rates",
            found: format!("learning_rate {learning_rate}, last {last}, clip {clip}"),
            expected: "learning_rate between 0 and 1, last from 0 to 1, clip above 0 and finite",
        })
    }

    /// Learning rate of a step, counted from 0, of so many.
    pub(crate) fn of_step(&self, step: usize, steps: usize) -> f64 {
        if step < self.warm_up {
            return self.learning_rate * (step + 1) as f64 / self.warm_up as f64;
        }
        let progress = (step - self.warm_up) as f64 / steps.saturating_sub(self.warm_up).max(1) as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
        self.learning_rate * (self.last + (1.0 - self.last) * cosine)
    }
}

/// Running means of gradients and of their squares. Not candle-nn's `AdamW`: its moments and its count of steps are private, so a run
/// could not be resumed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Adam {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    /// Updates done.
    pub(crate) updates: usize,
}

impl Adam {
    pub(crate) fn new(numbers: usize) -> Self {
        Self { first: vec![0.0; numbers], second: vec![0.0; numbers], updates: 0 }
    }

    /// An update by `gradients`, which are shortened to the rates' limit, in step `step` of `steps`. Nothing moves if the loss or a
    /// gradient is not finite.
    pub(crate) fn step(
        &mut self,
        rates: &Rates,
        (step, steps): (usize, usize),
        values: &mut [f32],
        mut gradients: Vec<f32>,
        loss: f64,
    ) -> Taken {
        let gradient = length(&gradients);
        let lr = rates.of_step(step, steps);
        let skipped = !(loss.is_finite() && gradient.is_finite());
        if !skipped {
            let factor = (f64::from(rates.clip) / gradient).min(1.0) as f32;
            gradients.iter_mut().for_each(|g| *g *= factor);
            self.update(values, &gradients, lr);
        }
        Taken { lr, gradient, skipped }
    }

    fn update(&mut self, values: &mut [f32], gradients: &[f32], rate: f64) {
        self.updates += 1;
        let power = |beta: f32| 1.0 - f64::from(beta).powf(self.updates as f64);
        let rate = (rate / power(BETA_1)) as f32;
        let correction = (1.0 / power(BETA_2)) as f32;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, gradient), (first, second)) in values.iter_mut().zip(gradients).zip(moments) {
            *first += (1.0 - BETA_1) * (gradient - *first);
            *second += (1.0 - BETA_2) * (gradient * gradient - *second);
            *value -= rate * *first / ((*second * correction).sqrt() + EPSILON);
        }
    }
}

/// What a step of the optimiser was.
pub(crate) struct Taken {
    /// Learning rate.
    pub(crate) lr: f64,
    /// Length of the gradient before it was shortened.
    pub(crate) gradient: f64,
    /// Whether it was left out.
    pub(crate) skipped: bool,
}

/// Euclidean length, in f64 and in order.
pub(crate) fn length(gradients: &[f32]) -> f64 {
    gradients.iter().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formulas_are_those_of_the_paper() {
        let gradients = [0.5, -0.25, 2.0];
        let (mut x, mut m, mut v) = (1.0f64, 0.0, 0.0);
        let (mut values, mut adam) = ([1.0f32], Adam::new(1));
        for (t, g) in (1..).zip(gradients) {
            (m, v) = (0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g);
            x -= 0.1 * (m / (1.0 - 0.9f64.powi(t))) / ((v / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
            adam.update(&mut values, &[g as f32], 0.1);
        }
        assert!((f64::from(values[0]) - x).abs() < 1e-5, "{} {x}", values[0]);
    }

    #[test]
    fn the_rate_rises_then_falls_to_its_last() {
        let rates = Rates { learning_rate: 1.0, warm_up: 10, last: 0.1, clip: 1.0 };
        let rate = |step| rates.of_step(step, 110);
        assert!(
            (rate(0) - 0.1).abs() < 1e-12 && (rate(9) - 1.0).abs() < 1e-12 && (rate(10) - 1.0).abs() < 1e-12
        );
        assert!(
            (rate(60) - 0.55).abs() < 1e-12 && (rate(110) - 0.1).abs() < 1e-12 && rate(500) >= 0.1 - 1e-12
        );
        assert!((0..110).all(|step| rate(step).is_finite() && rate(step) > 0.0));
    }
}
