//! Adam (Kingma & Ba 2015) over rows of stored numbers, damped: what a mean gradient is divided by has a floor.

use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Isa, dispatch};

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

/// Decay of the running mean of gradients, and the corrections of both running means for having started at 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Means {
    momentum: f32,
    first: f32,
    second: f32,
}

impl Means {
    /// For the `step`-th update, counted from 1.
    pub(crate) fn of_step(step: usize, momentum: f32) -> Self {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let correction = |decay: f32| 1.0 / (1.0 - decay.powi(step));
        Self { momentum, first: correction(momentum), second: correction(BETA_2) }
    }

    /// The root of the mean square of a number's gradients, the newest among them; `second` is the running mean before it.
    pub(crate) fn size(self, second: f32, gradient: f32) -> f32 {
        ((BETA_2 * second + (1.0 - BETA_2) * gradient * gradient) * self.second).sqrt()
    }
}

/// One update of a stretch of numbers, all slices of one length. A number whose gradients are of one size and sign moves by its rate, if
/// its floor is 0; with one it moves by rate · size / (size + floor). Numbers whose gradient was always 0 stay as they are. Every
/// instruction set gives the same bits.
pub(crate) fn update(
    isa: Isa,
    values: &mut [f32],
    gradients: &[f32],
    (first, second): (&mut [f32], &mut [f32]),
    (rates, floors): (&[f32], &[f32]),
    means: Means,
) {
    let n = values.len();
    let (gradients, rates, floors) = (&gradients[..n], &rates[..n], &floors[..n]);
    let (first, second) = (&mut first[..n], &mut second[..n]);
    dispatch(isa, Update { values, gradients, first, second, rates, floors, means });
}

struct Update<'a> {
    values: &'a mut [f32],
    gradients: &'a [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    rates: &'a [f32],
    floors: &'a [f32],
    means: Means,
}

impl WithSimd for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (values, values_rest) = S::as_mut_simd_f32s(self.values);
        let (gradients, gradients_rest) = S::as_simd_f32s(self.gradients);
        let (first, first_rest) = S::as_mut_simd_f32s(self.first);
        let (second, second_rest) = S::as_mut_simd_f32s(self.second);
        let (rates, rates_rest) = S::as_simd_f32s(self.rates);
        let (floors, floors_rest) = S::as_simd_f32s(self.floors);
        let moments = first.iter_mut().zip(second);
        let steps = rates.iter().zip(floors);
        for (((value, gradient), (rate, floor)), (first, second)) in
            values.iter_mut().zip(gradients).zip(steps).zip(moments)
        {
            (*value, [*first, *second]) =
                step(simd, *value, *gradient, [*first, *second], [*rate, *floor], self.means);
        }
        if !values_rest.is_empty() {
            let load = |slice: &[f32]| simd.partial_load_f32s(slice);
            let moments = [load(first_rest), load(second_rest)];
            let (gradient, rate_and_floor) = (load(gradients_rest), [load(rates_rest), load(floors_rest)]);
            let (value, [first, second]) =
                step(simd, load(values_rest), gradient, moments, rate_and_floor, self.means);
            simd.partial_store_f32s(values_rest, value);
            simd.partial_store_f32s(first_rest, first);
            simd.partial_store_f32s(second_rest, second);
        }
    }
}

/// A vector of numbers and of their two running means after an update.
#[inline(always)]
fn step<S: Simd>(
    simd: S,
    value: S::f32s,
    gradient: S::f32s,
    [first, second]: [S::f32s; 2],
    [rate, floor]: [S::f32s; 2],
    means: Means,
) -> (S::f32s, [S::f32s; 2]) {
    let splat = |v: f32| simd.splat_f32s(v);
    let (change, square) = (simd.sub_f32s(gradient, first), simd.mul_f32s(gradient, gradient));
    let first = simd.add_f32s(first, simd.mul_f32s(splat(1.0 - means.momentum), change));
    let second = simd.add_f32s(second, simd.mul_f32s(splat(1.0 - BETA_2), simd.sub_f32s(square, second)));
    let size = simd.sqrt_f32s(simd.mul_f32s(second, splat(means.second)));
    let size = simd.add_f32s(simd.add_f32s(size, floor), splat(EPSILON));
    let by = simd.div_f32s(simd.mul_f32s(rate, simd.mul_f32s(first, splat(means.first))), size);
    (simd.sub_f32s(value, by), [first, second])
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOMENTUM: f32 = 0.9;

    fn run(gradient: impl Fn(usize, f32) -> f32, steps: usize, rate: f32) -> f32 {
        damped(gradient, steps, rate, 0.0)
    }

    fn damped(gradient: impl Fn(usize, f32) -> f32, steps: usize, rate: f32, floor: f32) -> f32 {
        let (mut x, mut m) = ([1.0f32], Moments::new(1));
        for step in 1..=steps {
            let g = [gradient(step, x[0])];
            update(
                Isa::in_use(),
                &mut x,
                &g,
                (&mut m.first, &mut m.second),
                (&[rate], &[floor]),
                Means::of_step(step, MOMENTUM),
            );
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
    fn a_floor_slows_what_has_small_gradients() {
        // By rate · size / (size + floor).
        for (size, share) in [(1.0, 1.0 / 3.0), (2.0, 0.5), (1e-3, 1e-3 / 2.001), (1e6, 1.0)] {
            let moved = 1.0 - damped(|_, _| size, 5, 0.01, 2.0);
            assert!((moved / 0.05 - share).abs() < 1e-4, "{size}: {moved}");
        }
        assert_eq!(damped(|_, _| 0.0, 10, 1.0, 0.5), 1.0);
        // The size that floors are measured by is the one that the update divides by.
        let means = Means::of_step(1, MOMENTUM);
        assert!((means.size(0.0, -3.0) - 3.0).abs() < 1e-5);
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

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        // Whole vectors of every set and a rest; some numbers without a gradient.
        let n = 71;
        let gradients: Vec<f32> =
            (0..n).map(|i| ((i * 37 % 19) as f32 - 9.0) * 10f32.powi(i % 7 - 3)).collect();
        let rates: Vec<f32> = (1..=n).map(|i| i as f32 * 1e-3).collect();
        let floors: Vec<f32> = (0..n).map(|i| (i % 3) as f32).collect();
        let run = |isa| {
            let (mut values, mut m) = (vec![0.5f32; n as usize], Moments::new(n as usize));
            for step in 1..=3 {
                let moments = (m.first.as_mut_slice(), m.second.as_mut_slice());
                let means = Means::of_step(step, MOMENTUM);
                update(isa, &mut values, &gradients, moments, (&rates, &floors), means);
            }
            (values, m.first, m.second)
        };
        let expected = run(Isa::Scalar);
        assert!(expected.0.iter().any(|value| *value != 0.5));
        for isa in Isa::available() {
            assert_eq!(run(isa), expected, "{isa}");
        }
    }
}
