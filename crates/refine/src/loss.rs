//! The loss of one view and its derivative by the rendering.

use crate::{ColourTerm, Exposure, Loss};
use gs_scene::View;
use image_metrics::{SsimScratch, SsimTarget};
use rayon::prelude::*;

/// Numbers per parallel task. Fixed, and sums over tasks are taken in order, so that rounding does not depend
/// on threads.
pub(crate) const CHUNK: usize = 3 << 12;

/// Colours beyond this have a loss that f32 does not hold well: the step that led to them is not believed.
const LARGEST: f32 = 1e6;

/// A photograph that renderings are compared with.
#[derive(Debug)]
pub(crate) struct Target<'a> {
    photograph: &'a [f32],
    structure: Option<SsimTarget>,
}

/// What a comparison gives.
#[derive(Debug, Clone)]
pub(crate) struct Compared {
    /// Value of the loss.
    pub(crate) loss: f64,
    /// Of the rendering in the photograph's exposure, both clipped to 0..1, dB.
    pub(crate) psnr: f64,
    /// Derivative of the loss by the rendering, `[height, width, 3]`.
    pub(crate) by_rendering: Vec<f32>,
    /// Exposure in which the rendering would be closest to the photograph.
    pub(crate) fit: Exposure,
}

/// Sums over a stretch of numbers.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    colour: f64,
    /// Of squared differences after clipping.
    clipped: f64,
}

impl<'a> Target<'a> {
    pub(crate) fn new(view: &'a View, loss: Loss) -> Self {
        let photograph = view.image().data();
        let (width, height) = (view.image().width(), view.image().height());
        // There is none of a view that is smaller than its window.
        let structure = if loss.dssim > 0.0 { SsimTarget::new(photograph, width, height).ok() } else { None };
        Self { photograph, structure }
    }

    /// Compares a rendering, seen through an exposure, with the photograph; `None` if its colours are not
    /// finite or beyond all measure. The derivative is multiplied by `weight`.
    pub(crate) fn compare(
        &self,
        rendering: &[f32],
        exposure: Exposure,
        loss: Loss,
        weight: f32,
        scratch: &mut SsimScratch,
    ) -> Option<Compared> {
        let n = rendering.len();
        let Exposure { gain, bias } = exposure;
        if !is_comparable(rendering) {
            return None;
        }
        let exposed: Vec<f32>;
        let seen = if exposure == Exposure::NONE {
            rendering
        } else {
            exposed = rendering.par_iter().with_min_len(CHUNK).map(|v| gain * v + bias).collect();
            &exposed
        };
        let dssim = if self.structure.is_some() { loss.dssim } else { 0.0 };
        let of_colour = (1.0 - dssim) / n as f32;
        // Derivative by what is seen, to begin with.
        let mut gradient = vec![0f32; n];
        let tasks =
            gradient.par_chunks_mut(CHUNK).zip(seen.par_chunks(CHUNK)).zip(self.photograph.par_chunks(CHUNK));
        let sums: Vec<Sums> = tasks
            .map(|((gradient, seen), photograph)| match loss.colour {
                ColourTerm::Mse => colour_term(
                    gradient,
                    seen,
                    photograph,
                    |d| (f64::from(d * d), 2.0 * d),
                    weight * of_colour,
                ),
                ColourTerm::L1 => {
                    let sign = |d: f32| if d == 0.0 { 0.0 } else { d.signum() };
                    colour_term(
                        gradient,
                        seen,
                        photograph,
                        |d| (f64::from(d.abs()), sign(d)),
                        weight * of_colour,
                    )
                }
            })
            .collect();
        let total = sums.iter().fold(Sums::default(), |a, b| Sums {
            colour: a.colour + b.colour,
            clipped: a.clipped + b.clipped,
        });
        let mut value = f64::from(of_colour) * total.colour;
        if let Some(structure) = &self.structure {
            let share = structure.loss_with_gradient(seen, weight * dssim, &mut gradient, scratch).ok()?;
            value += f64::from(dssim) * share;
        }
        if gain != 1.0 {
            gradient.par_iter_mut().with_min_len(CHUNK).for_each(|g| *g *= gain);
        }
        Some(Compared {
            loss: value,
            psnr: psnr(total.clipped, n),
            by_rendering: gradient,
            fit: exposure.fit(rendering, self.photograph),
        })
    }

    /// The exposure in which a rendering would be closest to the photograph, and its PSNR without one, as [`Target::compare`] finds them.
    pub(crate) fn look(&self, rendering: &[f32]) -> Option<(Exposure, f64)> {
        if !is_comparable(rendering) {
            return None;
        }
        let pairs = rendering.par_chunks(CHUNK).zip(self.photograph.par_chunks(CHUNK));
        let squares = pairs.map(|(seen, photograph)| {
            seen.iter().zip(photograph).fold(0.0, |sum, (&seen, &photograph)| sum + clipped(seen, photograph))
        });
        let squares: Vec<f64> = squares.collect();
        let psnr = psnr(squares.iter().sum(), rendering.len());
        Some((Exposure::NONE.fit(rendering, self.photograph), psnr))
    }
}

/// Whether colours are finite and not beyond all measure.
fn is_comparable(rendering: &[f32]) -> bool {
    rendering.par_chunks(CHUNK).all(|chunk| chunk.iter().all(|v| v.abs() <= LARGEST))
}

/// The squared difference after clipping to 0..1.
fn clipped(seen: f32, photograph: f32) -> f64 {
    let difference = f64::from(seen.clamp(0.0, 1.0) - photograph.clamp(0.0, 1.0));
    difference * difference
}

/// dB, of `n` squared differences with this sum.
fn psnr(squares: f64, n: usize) -> f64 {
    -10.0 * (squares / n as f64).log10()
}

/// Writes the derivative of a sum of terms of the differences, times `weight`; `term` gives value and
/// derivative.
fn colour_term(
    gradient: &mut [f32],
    seen: &[f32],
    photograph: &[f32],
    term: impl Fn(f32) -> (f64, f32),
    weight: f32,
) -> Sums {
    let mut sums = Sums::default();
    for ((gradient, &seen), &photograph) in gradient.iter_mut().zip(seen).zip(photograph) {
        let (value, slope) = term(seen - photograph);
        *gradient = weight * slope;
        sums.colour += value;
        sums.clipped += clipped(seen, photograph);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Image, Intrinsics};
    use proptest::prelude::*;

    fn view(values: Vec<f32>) -> View {
        let lens = Intrinsics { fx: 20.0, fy: 20.0, cx: 6.0, cy: 6.0, width: 12, height: 12 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        View::new("v", Image::new(12, 12, values).unwrap(), camera, None).unwrap()
    }

    fn compare(view: &View, rendering: &[f32], exposure: Exposure, loss: Loss, weight: f32) -> Compared {
        let target = Target::new(view, loss);
        target.compare(rendering, exposure, loss, weight, &mut SsimScratch::default()).unwrap()
    }

    fn picture() -> impl Strategy<Value = Vec<f32>> {
        prop::collection::vec(0.05f32..0.95, 12 * 12 * 3)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn derivatives_are_those_of_the_value(
            photograph in picture(), rendering in picture(), gain in 0.6f32..1.4, bias in -0.2f32..0.2,
            dssim in prop::sample::select(vec![0.0f32, 0.3, 1.0]), index in 0usize..432, l1 in any::<bool>(),
        ) {
            let view = view(photograph);
            let loss = Loss { colour: if l1 { ColourTerm::L1 } else { ColourTerm::Mse }, dssim };
            let exposure = Exposure { gain, bias };
            let found = compare(&view, &rendering, exposure, loss, 1.0);
            // The value by its definition, in f64: differences of the f32 value would be mostly its rounding.
            let value = |rendering: &[f32]| {
                let photograph = view.image().data();
                let seen: Vec<f32> = rendering.iter().map(|v| gain * v + bias).collect();
                let differences = seen.iter().zip(photograph).map(|(a, b)| f64::from(*a) - f64::from(*b));
                let colour: f64 = differences.map(|d| if l1 { d.abs() } else { d * d }).sum();
                let structure = 1.0 - image_metrics::ssim_rgb(&seen, photograph, 12, 12).unwrap();
                f64::from(1.0 - dssim) * colour / 432.0 + f64::from(dssim) * structure
            };
            prop_assert!((found.loss - value(&rendering)).abs() < 1e-6);
            let step = 1.0 / 1024.0;
            let difference = f64::from(gain * rendering[index] + bias - view.image().data()[index]).abs();
            // No kink of |d| between the two values.
            if !l1 || difference > 2.0 * step {
                let moved = |by: f64| {
                    let mut moved = rendering.clone();
                    moved[index] += by as f32;
                    (f64::from(moved[index]), value(&moved))
                };
                let ((low, below), (high, above)) = (moved(-step), moved(step));
                let slope = (above - below) / (high - low);
                let found = f64::from(found.by_rendering[index]);
                // The second term is what a finite step misses.
                prop_assert!((slope - found).abs() < 1e-6 + 2e-3 * slope.abs(), "{slope} {found}");
            }
            let doubled = compare(&view, &rendering, exposure, loss, 2.0);
            prop_assert!((doubled.loss, doubled.psnr) == (found.loss, found.psnr));
            prop_assert!((doubled.by_rendering[index] - 2.0 * found.by_rendering[index]).abs() < 1e-6);
        }
    }

    #[test]
    fn equal_pictures_have_no_loss_and_wild_ones_no_comparison() {
        let view = view(vec![0.4; 432]);
        for colour in [ColourTerm::Mse, ColourTerm::L1] {
            let loss = Loss { colour, dssim: 0.2 };
            let same = compare(&view, view.image().data(), Exposure::NONE, loss, 1.0);
            assert_eq!((same.loss, same.psnr), (0.0, f64::INFINITY));
            assert!(same.by_rendering.iter().all(|g| *g == 0.0));
            let target = Target::new(&view, loss);
            for wild in [f32::NAN, f32::INFINITY, 1e30] {
                let mut rendering = vec![0.4; 432];
                rendering[7] = wild;
                let mut scratch = SsimScratch::default();
                assert!(target.compare(&rendering, Exposure::NONE, loss, 1.0, &mut scratch).is_none());
                assert!(target.look(&rendering).is_none());
            }
        }
    }

    #[test]
    fn psnr_is_that_of_the_metrics() {
        // A photograph brought into another exposure may leave 0..1.
        let photograph: Vec<f32> = (0..432).map(|i| (i % 11) as f32 / 8.0 - 0.1).collect();
        let rendering: Vec<f32> = (0..432).map(|i| (i % 7) as f32 / 4.0 - 0.3).collect();
        let view = view(photograph);
        let compared = compare(&view, &rendering, Exposure::NONE, Loss::default(), 1.0);
        let found = compared.psnr;
        let looked = Target::new(&view, Loss::default()).look(&rendering);
        assert_eq!(looked, Some((compared.fit, found)));
        let other = Image::new(12, 12, rendering).unwrap();
        assert!((found - image_metrics::psnr(view.image(), &other).unwrap()).abs() < 1e-5);
    }
}
