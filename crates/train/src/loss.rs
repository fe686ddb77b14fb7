//! The loss of a picture and its derivative.

use crate::{Error, Result};
use gs_scene::View;
use image_metrics::{Lpips, LpipsTarget, SsimScratch, SsimTarget};

/// A photograph that renderings are compared with: (1 - λ)·MSE + λ·structure (paper, section 3.4, where structure is
/// LPIPS; without its weights D-SSIM = 1 - SSIM stands in).
pub(crate) struct Loss {
    photograph: Vec<f32>,
    structure: Option<Structure>,
    lambda: f32,
}

enum Structure {
    Ssim(SsimTarget),
    Lpips(LpipsTarget),
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
    /// The structural term is LPIPS where it is given.
    pub(crate) fn new(view: &View, lambda: f32, lpips: Option<&Lpips>) -> Result<Self> {
        let image = view.image();
        let target = || match lpips {
            Some(lpips) => lpips.target(image).map(Structure::Lpips),
            None => SsimTarget::new(image.data(), image.width(), image.height()).map(Structure::Ssim),
        };
        let structure = (lambda > 0.0)
            .then(target)
            .transpose()
            .map_err(|source| Error::Metric { view: view.name().to_owned(), source })?;
        Ok(Self { photograph: image.data().to_vec(), structure, lambda })
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
            loss += f64::from(self.lambda) * structure.compare(rendering, self.lambda, &mut by_rendering)?;
        }
        Ok(Compared { loss, clipped_mse: clipped / n, by_rendering })
    }
}

impl Structure {
    /// The term; `weight` times its derivative is added to `by_rendering`.
    fn compare(
        &self,
        rendering: &[f32],
        weight: f32,
        by_rendering: &mut [f32],
    ) -> Result<f64, image_metrics::Error> {
        match self {
            Self::Ssim(target) => {
                target.loss_with_gradient(rendering, weight, by_rendering, &mut SsimScratch::default())
            }
            Self::Lpips(target) => {
                // As a screen shows it: beyond 0..1 nothing changes.
                let clipped: Vec<f32> = rendering.iter().map(|value| value.clamp(0.0, 1.0)).collect();
                let (distance, gradient) = target.distance_and_gradient(&clipped)?;
                for ((sum, by), (value, clipped)) in
                    by_rendering.iter_mut().zip(gradient).zip(rendering.iter().zip(&clipped))
                {
                    if value == clipped {
                        *sum += weight * by;
                    }
                }
                Ok(distance)
            }
        }
    }
}
