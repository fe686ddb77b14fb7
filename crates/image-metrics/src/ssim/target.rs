use super::SSIM_WINDOW;
use super::band::Scratch;
use super::reference::Reference;
use crate::check::moderate;
use crate::{Error, Result};

/// A picture that another is fitted to: 1 - SSIM and its derivative in f32, fast enough for every step of an
/// optimisation.
///
/// Holds a copy of the picture and the means and variances of its windows, which do not change between steps: three
/// times the size of the picture. Can be shared between threads; each caller brings its own [`SsimScratch`].
#[derive(Debug, Clone)]
pub struct SsimTarget {
    reference: Reference<f32>,
}

/// What [`SsimTarget::loss_with_gradient`] keeps between calls, so that it allocates next to nothing. Serves targets
/// of any size, one after the other; about 1 KiB times the width for each of two bands of rows per thread.
#[derive(Debug, Clone, Default)]
pub struct SsimScratch {
    bands: Vec<Scratch<f32>>,
}

impl SsimTarget {
    /// From values `[height, width, 3]`, nominally 0..1.
    ///
    /// # Errors
    /// If the length does not fit the size, a side is below [`SSIM_WINDOW`], or a value is not finite or beyond ±10⁶.
    pub fn new(values: &[f32], width: usize, height: usize) -> Result<Self> {
        moderate("target", values, width, height, SSIM_WINDOW)?;
        Ok(Self { reference: Reference::new(values, width, height) })
    }

    /// Pixels per row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.reference.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.reference.height
    }

    /// 1 - SSIM of `picture` `[height, width, 3]` and the target, with SSIM as [`ssim`](crate::ssim()) defines it; and
    /// *adds* `weight` times its derivative by `picture` to `gradient`, of the same shape. Values are not clipped.
    ///
    /// Computed in f32 relative to the means of both pictures: the loss is within 1e-5 of that in f64, an element of the
    /// derivative within 1e-4 of the largest one, for flat and bright pictures too. (4e-4, if wide areas are exactly flat
    /// in both pictures, with differences of 0.6 and more of either sign.) A picture that equals its target has the loss
    /// 0 and the derivative 0 exactly. The same bytes come out on any number of threads.
    ///
    /// # Errors
    /// If a length does not fit the target, or a value is not finite or beyond ±10⁶; `gradient` is then as it was.
    pub fn loss_with_gradient(
        &self,
        picture: &[f32],
        weight: f32,
        gradient: &mut [f32],
        scratch: &mut SsimScratch,
    ) -> Result<f64> {
        moderate("fitted", picture, self.width(), self.height(), SSIM_WINDOW)?;
        if gradient.len() != picture.len() {
            return Err(Error::GradientLength { expected: picture.len(), found: gradient.len() });
        }
        Ok(self.reference.loss_with_gradient(picture, weight, gradient, &mut scratch.bands))
    }
}
