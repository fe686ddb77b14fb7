//! Gain and bias of each view: photograph ≈ gain · rendering + bias.

use crate::loss::CHUNK;
use rayon::prelude::*;
use serde::Serialize;

/// Gains and biases are only fitted if, at the start, one of them would move a dark or a light grey by more
/// than this (0..1): below, they would fit errors of the scene.
const NOTICEABLE: f64 = 0.02;
/// Share of the way to the best fit that a comparison moves the exposure of its view: the scene changes
/// meanwhile.
const STEP: f32 = 0.2;
/// Variance of colours that speaks for the gain as it was: a view of one colour has no gain.
const PRIOR: f64 = 0.01;

/// What the camera did to a view: photograph ≈ gain · rendering + bias. 1 and 0 if nothing; over all views
/// the mean gain is 1 and the mean bias 0, so that the scene keeps its exposure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Exposure {
    /// Factor.
    pub gain: f32,
    /// Offset, 0..1.
    pub bias: f32,
}

impl Exposure {
    /// No change.
    pub const NONE: Self = Self { gain: 1.0, bias: 0.0 };

    /// Least squares of a photograph by its rendering, drawn towards the gain `self` and kept within a factor
    /// of two. Drawn towards no change, step by step, the scene would follow.
    pub(crate) fn fit(self, rendering: &[f32], photograph: &[f32]) -> Self {
        // Count, sums, sum of squares and of products; task by task, so that rounding does not depend on threads.
        let of_task = |(rendering, photograph): (&[f32], &[f32])| {
            let mut sums = [0.0f64; 5];
            for (&a, &b) in rendering.iter().zip(photograph) {
                // What is black or blown out has lost its exposure. (In a photograph that was brought into
                // another exposure such pixels are no longer told apart: few, as a rule.)
                if (0.02..0.98).contains(&b) {
                    let (a, b) = (f64::from(a), f64::from(b));
                    sums.iter_mut().zip([1.0, a, b, a * a, a * b]).for_each(|(sum, term)| *sum += term);
                }
            }
            sums
        };
        let tasks: Vec<[f64; 5]> =
            rendering.par_chunks(CHUNK).zip(photograph.par_chunks(CHUNK)).map(of_task).collect();
        let [n, r, p, rr, rp] =
            tasks.iter().fold([0.0; 5], |total, sums| std::array::from_fn(|k| total[k] + sums[k]));
        if n == 0.0 {
            return self;
        }
        let (mean_r, mean_p) = (r / n, p / n);
        let before = f64::from(self.gain);
        let gain = (rp / n - mean_r * mean_p + PRIOR * before) / (rr / n - mean_r * mean_r + PRIOR);
        let gain = gain.clamp(0.5, 2.0);
        Self { gain: gain as f32, bias: (mean_p - gain * mean_r) as f32 }
    }

    /// How far a dark or a light grey is moved, whichever is more.
    fn effect(self) -> f64 {
        let moved = |grey: f64| (f64::from(self.gain) * grey + f64::from(self.bias) - grey).abs();
        moved(0.2).max(moved(0.8))
    }
}

/// The exposures of all views while they are being fitted.
#[derive(Debug)]
pub(crate) struct Exposures {
    views: Vec<Exposure>,
    /// Whether the views disagree.
    pub(crate) fitted: bool,
}

impl Exposures {
    /// From the exposures in which the photographs are closest to the scene at the start.
    pub(crate) fn new(mut at_start: Vec<Exposure>) -> Self {
        level(&mut at_start);
        let fitted = at_start.iter().any(|view| view.effect() > NOTICEABLE);
        if !fitted {
            at_start.fill(Exposure::NONE);
        }
        Self { views: at_start, fitted }
    }

    /// That of a view; none for views beyond, which are no photographs.
    pub(crate) fn of(&self, view: usize) -> Exposure {
        self.views.get(view).copied().unwrap_or(Exposure::NONE)
    }

    pub(crate) fn all(self) -> Vec<Exposure> {
        self.views
    }

    /// A view was compared, and this is where it would be closest to the scene.
    pub(crate) fn draw(&mut self, view: usize, fit: Exposure) {
        if self.fitted {
            let exposure = &mut self.views[view];
            exposure.gain += STEP * (fit.gain - exposure.gain);
            exposure.bias += STEP * (fit.bias - exposure.bias);
            level(&mut self.views);
        }
    }
}

/// Takes away what all views have in common: that is the scene's.
fn level(views: &mut [Exposure]) {
    let n = views.len() as f32;
    let gain = views.iter().map(|view| view.gain).sum::<f32>() / n;
    let bias = views.iter().map(|view| view.bias).sum::<f32>() / n;
    for view in views {
        // Views that differ by more than a factor of two have nothing in common any more; a gain stays one.
        view.gain = (view.gain + 1.0 - gain).clamp(0.25, 4.0);
        view.bias -= bias;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_finds_the_exposure_and_a_flat_view_has_a_bias_only() {
        let rendering: Vec<f32> = (0..300).map(|i| (i as f32 * 0.7).sin() * 0.35 + 0.5).collect();
        let photograph: Vec<f32> = rendering.iter().map(|v| 0.8 * v + 0.05).collect();
        let fit = Exposure::NONE.fit(&rendering, &photograph);
        assert!((fit.gain - 0.8).abs() < 0.05 && (fit.gain * 0.5 + fit.bias - 0.45).abs() < 1e-3, "{fit:?}");
        let flat = Exposure::NONE.fit(&[0.5; 9], &[0.6; 9]);
        assert!((flat.gain - 1.0).abs() < 1e-6 && (flat.bias - 0.1).abs() < 1e-6);
        assert_eq!(Exposure::NONE.fit(&[0.5; 9], &[1.0; 9]), Exposure::NONE);
        assert_eq!(Exposure::NONE.fit(&[], &[]), Exposure::NONE);
        let inverted: Vec<f32> = rendering.iter().map(|v| 1.0 - v).collect();
        assert_eq!(Exposure::NONE.fit(&rendering, &inverted).gain, 0.5);
    }

    #[test]
    fn views_that_agree_are_left_alone_whatever_they_agree_on() {
        let dark = Exposure { gain: 0.7, bias: 0.1 };
        assert!(!Exposures::new(vec![dark; 4]).fitted);
        assert!(Exposures::new(vec![dark, Exposure::NONE]).fitted);
        assert!(!Exposures::new(vec![dark]).fitted, "one view has nobody to disagree with");
    }

    #[test]
    fn they_are_drawn_to_the_fit_and_keep_their_mean() {
        let fit = [Exposure { gain: 0.8, bias: 0.1 }, Exposure { gain: 1.2, bias: -0.1 }];
        let mut exposures = Exposures::new(vec![fit[1], fit[0]]);
        (0..60).for_each(|i| exposures.draw(i % 2, fit[i % 2]));
        let [a, b] = [exposures.of(0), exposures.of(1)];
        assert!((a.gain + b.gain - 2.0).abs() < 1e-6 && (a.bias + b.bias).abs() < 1e-6);
        assert!((a.gain - 0.8).abs() < 0.02 && (b.bias + 0.1).abs() < 0.02, "{a:?} {b:?}");
        let mut agree = Exposures::new(vec![Exposure::NONE; 2]);
        agree.draw(0, fit[0]);
        assert_eq!(agree.of(0), Exposure::NONE);
    }
}
