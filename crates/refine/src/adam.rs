//! Adam (Kingma & Ba 2015) over rows of stored numbers.

use multiversion::multiversion;

/// Decay of the running mean of gradients.
const BETA_1: f32 = 0.9;
/// Decay of the running mean of squared gradients. Short: there are tens of steps, not thousands.
const BETA_2: f32 = 0.99;
/// Below any gradient that matters (a loss is at most about 1 and shared among all Gaussians), above rounding
/// to 0.
const EPSILON: f32 = 1e-15;

/// Running means of gradients and of their squares, one pair per number.
#[derive(Debug, Clone)]
pub(crate) struct Moments {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
}

impl Moments {
    pub(crate) fn new(numbers: usize) -> Self {
        Self { first: vec![0.0; numbers], second: vec![0.0; numbers] }
    }
}

/// Corrections of both running means for having started at 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Correction {
    first: f32,
    second: f32,
}

impl Correction {
    /// For the `step`-th update, counted from 1.
    pub(crate) fn of_step(step: usize) -> Self {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        Self { first: 1.0 / (1.0 - BETA_1.powi(step)), second: 1.0 / (1.0 - BETA_2.powi(step)) }
    }
}

/// One update of a stretch of numbers, all slices of one length: a number whose gradients are of one size and
/// sign moves by its rate. Numbers whose gradient was always 0 stay as they are.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(crate) fn update(
    values: &mut [f32],
    gradients: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    rates: &[f32],
    correction: Correction,
) {
    let n = values.len();
    let (gradients, rates) = (&gradients[..n], &rates[..n]);
    let (first, second) = (&mut first[..n], &mut second[..n]);
    for i in 0..n {
        let gradient = gradients[i];
        first[i] += (1.0 - BETA_1) * (gradient - first[i]);
        second[i] += (1.0 - BETA_2) * (gradient * gradient - second[i]);
        let size = (second[i] * correction.second).sqrt() + EPSILON;
        values[i] -= rates[i] * (first[i] * correction.first) / size;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(gradient: impl Fn(usize, f32) -> f32, steps: usize, rate: f32) -> f32 {
        let (mut x, mut m) = ([1.0f32], Moments::new(1));
        for step in 1..=steps {
            let g = [gradient(step, x[0])];
            update(&mut x, &g, &mut m.first, &mut m.second, &[rate], Correction::of_step(step));
        }
        x[0]
    }

    #[test]
    fn a_steady_gradient_moves_by_the_rate_whatever_its_size() {
        for size in [1e-9, 1e-3, 1e6] {
            assert!((run(|_, _| size, 5, 0.01) - 0.95).abs() < 1e-5, "{size}");
            assert!((run(|_, _| -size, 5, 0.01) - 1.05).abs() < 1e-5, "{size}");
        }
    }

    #[test]
    fn it_finds_a_minimum_and_rests_without_a_gradient() {
        assert!((run(|_, x| x - 0.3, 400, 0.02) - 0.3).abs() < 1e-3);
        assert_eq!(run(|_, _| 0.0, 10, 1.0), 1.0);
    }

    #[test]
    fn the_formulas_are_those_of_the_paper() {
        // Three steps by hand in f64.
        let gradients = [0.5, -0.25, 2.0];
        let (mut x, mut m, mut v) = (1.0f64, 0.0, 0.0);
        for (t, g) in (1..).zip(gradients) {
            (m, v) = (0.9 * m + 0.1 * g, 0.99 * v + 0.01 * g * g);
            x -= 0.1 * (m / (1.0 - 0.9f64.powi(t))) / (v / (1.0 - 0.99f64.powi(t))).sqrt();
        }
        let found = run(|step, _| gradients[step - 1] as f32, 3, 0.1);
        assert!((f64::from(found) - x).abs() < 1e-6, "{found} {x}");
    }
}
