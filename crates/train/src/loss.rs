//! The loss of a picture and its derivative.

use crate::ops::{lock, numbers};
use crate::{Error, Result};
use candle_core::{CpuStorage, CustomOp1, Device, Layout, Shape, Tensor, bail};
use candle_nn::loss::mse;
use gs_scene::View;
use image_metrics::{Lpips, LpipsTarget, SsimScratch, SsimTarget};
use std::sync::{Arc, Mutex};

/// A photograph that renderings are compared with: (1 - λ)·MSE + λ·structure (paper, section 3.4, where structure is
/// LPIPS; without its weights D-SSIM = 1 - SSIM stands in).
pub(crate) struct Loss {
    /// `[height, width, 3]`.
    photograph: Tensor,
    structure: Option<Arc<Structure>>,
    lambda: f32,
}

enum Structure {
    Ssim(SsimTarget),
    Lpips(LpipsTarget),
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
            .map_err(|source| Error::Metric { view: view.name().to_owned(), source })?
            .map(Arc::new);
        let shape = (image.height(), image.width(), 3);
        Ok(Self { photograph: Tensor::from_slice(image.data(), shape, &Device::Cpu)?, structure, lambda })
    }

    /// The loss of a rendering `[height, width, 3]`; not finite where the rendering is not.
    pub(crate) fn of(&self, rendering: &Tensor) -> Result<Tensor> {
        let square = (mse(rendering, &self.photograph)? * f64::from(1.0 - self.lambda))?;
        Ok(match &self.structure {
            Some(structure) if square.to_scalar::<f32>()?.is_finite() => {
                let (structure, weight) = (Arc::clone(structure), self.lambda);
                (square
                    + rendering.apply_op1(Structural { structure, weight, gradient: Mutex::default() })?)?
            }
            _ => square,
        })
    }
}

/// Mean square error of a rendering after clipping to 0..1.
pub(crate) fn clipped_mse(rendering: &[f32], photograph: &View) -> f64 {
    let differences = rendering
        .iter()
        .zip(photograph.image().data())
        .map(|(seen, photograph)| f64::from(seen.clamp(0.0, 1.0) - photograph));
    differences.map(|difference| difference * difference).sum::<f64>() / rendering.len() as f64
}

/// A rendering to its structural term times `weight`.
struct Structural {
    structure: Arc<Structure>,
    weight: f32,
    /// By the rendering; the forward pass leaves it to the backward pass.
    gradient: Mutex<Vec<f32>>,
}

impl Structural {
    /// The term, and `weight` times its derivative.
    fn compare(&self, rendering: &[f32]) -> Result<(f64, Vec<f32>), image_metrics::Error> {
        match &*self.structure {
            Structure::Ssim(target) => {
                let mut gradient = vec![0.0; rendering.len()];
                let scratch = &mut SsimScratch::default();
                let loss = target.loss_with_gradient(rendering, self.weight, &mut gradient, scratch)?;
                Ok((loss, gradient))
            }
            Structure::Lpips(target) => {
                // As a screen shows it: beyond 0..1 nothing changes.
                let clipped: Vec<f32> = rendering.iter().map(|value| value.clamp(0.0, 1.0)).collect();
                let (distance, mut gradient) = target.distance_and_gradient(&clipped)?;
                for (by, (value, clipped)) in gradient.iter_mut().zip(rendering.iter().zip(&clipped)) {
                    *by = if value == clipped { self.weight * *by } else { 0.0 };
                }
                Ok((distance, gradient))
            }
        }
    }
}

impl CustomOp1 for Structural {
    fn name(&self) -> &'static str {
        "structure"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> candle_core::Result<(CpuStorage, Shape)> {
        let (term, gradient) = self.compare(numbers(storage, layout)?).map_err(candle_core::Error::wrap)?;
        *lock(&self.gradient) = gradient;
        Ok((CpuStorage::F32(vec![(f64::from(self.weight) * term) as f32]), ().into()))
    }

    fn bwd(&self, rendering: &Tensor, _: &Tensor, by_term: &Tensor) -> candle_core::Result<Option<Tensor>> {
        let gradient = std::mem::take(&mut *lock(&self.gradient));
        if gradient.is_empty() {
            bail!("no structure was compared, or backward ran before");
        }
        let gradient = Tensor::from_vec(gradient, rendering.shape(), rendering.device())?;
        Ok(Some(gradient.broadcast_mul(by_term)?))
    }
}
