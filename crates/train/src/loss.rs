//! The loss of a picture and its derivative.

use crate::{Error, Result};
use gs_scene::View;
use image_metrics::{SsimScratch, SsimTarget};

/// A photograph that renderings are compared with: (1 - λ)·MSE + λ·structure (paper, section 3.4, where structure is
/// LPIPS; without its weights D-SSIM = 1 - SSIM stands in).
pub(crate) struct Loss {
    photograph: Vec<f32>,
    structure: Option<SsimTarget>,
    lambda: f32,
}

/// What a comparison gives.
#[derive(Debug, Clone)]
pub(crate) struct Compared {
    /// Value of the loss; not finite where the picture is not.
    pub(crate) loss: f64,
    /// Mean square error after clipping to 0..1.
    pub(crate) clipped_mse: f64,
    /// Derivative by the rendering, `[height, width, 3]`.
    pub(crate) by_rendering: Vec<f32>,
}

impl Loss {
    pub(crate) fn new(view: &View, lambda: f32) -> Result<Self> {
        let photograph = view.image().data().to_vec();
        let structure = (lambda > 0.0)
            .then(|| SsimTarget::new(&photograph, view.image().width(), view.image().height()))
            .transpose()
            .map_err(|source| Error::Metric { view: view.name().to_owned(), source })?;
        Ok(Self { photograph, structure, lambda })
    }

    pub(crate) fn compare(&self, rendering: &[f32]) -> Result<Compared, image_metrics::Error> {
        let n = rendering.len() as f64;
        let (mut square, mut clipped) = (0.0, 0.0);
        let factor = (f64::from(1.0 - self.lambda) * 2.0 / n) as f32;
        let mut by_rendering = Vec::with_capacity(rendering.len());
        for (seen, photograph) in rendering.iter().zip(&self.photograph) {
            let difference = seen - photograph;
            square += f64::from(difference) * f64::from(difference);
            let bounded = f64::from(seen.clamp(0.0, 1.0) - photograph);
            clipped += bounded * bounded;
            by_rendering.push(factor * difference);
        }
        let mut loss = f64::from(1.0 - self.lambda) * square / n;
        if let (Some(structure), true) = (&self.structure, loss.is_finite()) {
            let share = structure.loss_with_gradient(
                rendering,
                self.lambda,
                &mut by_rendering,
                &mut SsimScratch::default(),
            )?;
            loss += f64::from(self.lambda) * share;
        }
        Ok(Compared { loss, clipped_mse: clipped / n, by_rendering })
    }
}
