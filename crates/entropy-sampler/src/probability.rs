//! The probability map (paper, eq. "prob_map") and its solution for a budget.

use crate::{Error, ImportanceMap, Result, parallel};

/// The rule that turns importance v and weight w of a pixel into its probability P of being chosen:
///
/// P = min(1, lift · w · min(1, tau · v)) where v > 0, and min(1, lift · w · flat) where v = 0.
///
/// With `flat` 0 and `lift` 1 this is the paper's rule times the weight. The other two only come into play, in this
/// order, when the budget is more than that rule can reach (see [`solve`]).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Probability {
    /// The paper's knob, above 0; 0 only where no usable pixel has any importance.
    pub tau: f64,
    /// Probability of pixels without importance, before the weight; above 0 only if all others are saturated.
    pub flat: f64,
    /// Factor on all weights; above 1 only if everything else is saturated.
    pub lift: f64,
}

impl Probability {
    /// The paper's rule.
    ///
    /// # Errors
    /// If tau is not a finite number above 0.
    pub fn from_tau(tau: f64) -> Result<Self> {
        if !(tau.is_finite() && tau > 0.0) {
            return Err(Error::Tau { found: tau });
        }
        Ok(Self { tau, flat: 0.0, lift: 1.0 })
    }

    /// P of a pixel of this importance and weight.
    #[must_use]
    pub fn of(&self, value: f32, weight: f64) -> f64 {
        let unweighted = if value > 0.0 { (self.tau * f64::from(value)).min(1.0) } else { self.flat };
        (self.lift * weight * unweighted).min(1.0)
    }

    /// P of every pixel, `[height, width]`.
    #[must_use]
    pub fn map(&self, map: &ImportanceMap) -> Vec<f64> {
        let mut out = vec![0.0; map.values().len()];
        parallel::for_each_chunk(&mut out, PIXELS, |task, out| {
            for (pixel, out) in (task * PIXELS..).zip(out) {
                *out = self.of(map.values()[pixel], map.weight(pixel));
            }
        });
        out
    }

    /// Expected number of chosen pixels: the sum of P.
    #[must_use]
    pub fn expected(&self, maps: &[ImportanceMap]) -> f64 {
        let [sum] = sums(maps, |value, weight| [self.of(value, weight)]);
        sum
    }

    /// Whether the budget was more than tau alone can reach, so that pixels without importance take part.
    #[must_use]
    pub fn exhausts_importance(&self) -> bool {
        self.flat > 0.0 || self.lift > 1.0
    }
}

/// The rule whose expected count over all views together is `expected`.
///
/// Tau is solved exactly (the expected count is piecewise linear in it). Where even saturated importance is too
/// little, the rest of the budget is met in this order: pixels without importance, all with the same probability
/// before the weight; then all weights raised by one factor. At the end every pixel of weight above 0 has P = 1, and
/// a budget beyond their number gives just that.
///
/// # Errors
/// If `expected` is not a finite number above 0, or there are no maps, or all weights are 0.
pub fn solve(maps: &[ImportanceMap], expected: f64) -> Result<Probability> {
    if !(expected.is_finite() && expected > 0.0) {
        return Err(Error::ExpectedCount { found: expected });
    }
    if maps.is_empty() {
        return Err(Error::NoMaps);
    }
    let [important, flat, usable] = sums(maps, |value, weight| {
        let (yes, no) = if value > 0.0 { (weight, 0.0) } else { (0.0, weight) };
        [yes, no, f64::from(weight > 0.0)]
    });
    if usable == 0.0 {
        return Err(Error::NoUsablePixel);
    }
    let mut rule = Probability { tau: 0.0, flat: 0.0, lift: 1.0 };
    if important > 0.0 {
        rule.tau = solve_scale(maps, expected.min(important), |value, weight| (f64::from(value), weight));
    }
    if expected > important && flat > 0.0 {
        rule.flat = ((expected - important) / flat).min(1.0);
    }
    if expected > important + flat {
        rule.lift = solve_scale(maps, expected.min(usable), |_, weight| (weight, 1.0)).max(1.0);
    }
    Ok(rule)
}

/// The smallest s with Σ weight · min(1, s · value) = `target`, for a target that can be reached; `pixel` gives
/// (value, weight).
///
/// The sum is concave and piecewise linear in s, so that Newton's method from 0 rises to the solution without passing
/// it, and is exact once no further pixel saturates: some five passes on a picture, none of them a sort.
fn solve_scale(maps: &[ImportanceMap], target: f64, pixel: impl Fn(f32, f64) -> (f64, f64) + Sync) -> f64 {
    let mut scale = 0.0;
    loop {
        let [saturated, slope] = sums(maps, |value, weight| {
            let (value, weight) = pixel(value, weight);
            let saturated = f64::from(scale * value >= 1.0);
            [saturated * weight, (1.0 - saturated) * weight * value]
        });
        let next = (target - saturated) / slope;
        // No slope: all is saturated. No rise: nothing new saturated, or rounding has the last word.
        if slope <= 0.0 || next <= scale {
            return scale;
        }
        scale = next;
    }
}

/// Pixels per parallel task. Fixed, and its sums are added in order, so that rounding does not depend on threads.
const PIXELS: usize = 1 << 14;

/// Sums over all pixels of all views; `terms` gets importance and weight.
fn sums<const N: usize>(maps: &[ImportanceMap], terms: impl Fn(f32, f64) -> [f64; N] + Sync) -> [f64; N] {
    let mut total = [0.0; N];
    for map in maps {
        let partial = parallel::map(map.values().len().div_ceil(PIXELS), |task| {
            let part = task * PIXELS..map.values().len().min((task + 1) * PIXELS);
            let values = &map.values()[part.clone()];
            match map.weights() {
                None => lane_sums(values, |i| terms(values[i], 1.0)),
                Some(weights) => {
                    let weights = &weights[part];
                    lane_sums(values, |i| terms(values[i], f64::from(weights[i])))
                }
            }
        });
        total = partial.into_iter().fold(total, add);
    }
    total
}

/// The terms of all indices of `values`, summed in interleaved lanes, which keeps additions from waiting for each other.
fn lane_sums<const N: usize>(values: &[f32], terms: impl Fn(usize) -> [f64; N]) -> [f64; N] {
    const LANES: usize = 4;
    let mut lanes = [[0.0; N]; LANES];
    let even = values.len() / LANES * LANES;
    for start in (0..even).step_by(LANES) {
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum = add(*sum, terms(start + lane));
        }
    }
    let rest = (even..values.len()).fold([0.0; N], |sum, i| add(sum, terms(i)));
    lanes.into_iter().fold(rest, add)
}

fn add<const N: usize>(a: [f64; N], b: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] + b[i])
}
