//! The learned distance of Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric", 2018.

mod architecture;
mod compare;
mod convolution;
mod maps;
mod network;
mod pool;
mod weights;

pub use architecture::LpipsNetwork;
pub use tensor_files::{WeightFault, WeightProblem};

use crate::check::moderate;
use crate::{Error, Result};
use gs_scene::Image;
use maps::Maps;
use network::Record;
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;
use weights::{SCALE, SHIFT, Weights};

/// Learned perceptual image patch similarity (LPIPS), version 0.1 of the metric with its linear layers: features of a
/// network, each pixel's normalized over the channels, squared differences weighted by channel, mean over the pixels,
/// sum over five or seven layers. 0 for equal pictures; smaller is more alike.
///
/// Pictures have values nominally in 0..1, which are taken as they are: a caller who measures renderings clips them
/// first.
#[derive(Clone)]
pub struct Lpips {
    weights: Arc<Weights>,
    minimum: usize,
}

/// A picture that others are compared with: its features, computed once.
#[derive(Clone)]
pub struct LpipsTarget {
    lpips: Lpips,
    width: usize,
    height: usize,
    /// Normalized features of every layer.
    features: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads published weights: a file of torchvision (`vgg16-….pth`, `alexnet-….pth`, `squeezenet1_1-….pth`) and the
    /// metric's linear layers for it (`vgg.pth`, `alex.pth`, `squeeze.pth` of version 0.1), in any order, or one file
    /// with both, of PyTorch or safetensors. Which network it is, its tensors tell.
    ///
    /// # Errors
    /// If a file cannot be read or is none of weights, or tensors are missing, unexpected, misshapen or not finite: all
    /// of them are named.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        Ok(Self::new(weights::read(paths)?))
    }

    fn new(weights: Weights) -> Self {
        let minimum = weights.layers.minimum();
        Self { weights: Arc::new(weights), minimum }
    }

    /// The network whose features are compared.
    pub fn network(&self) -> LpipsNetwork {
        self.weights.network
    }

    /// The shortest side of a picture, pixels.
    pub fn minimum(&self) -> usize {
        self.minimum
    }

    /// The features of a picture that others are to be compared with.
    ///
    /// # Errors
    /// If a side is below [`Lpips::minimum`], a value is not finite or beyond ±10⁶, or the features overflow.
    pub fn target(&self, picture: &Image) -> Result<LpipsTarget> {
        let (width, height) = (picture.width(), picture.height());
        let (_, records) = self.features("target", picture.data(), width, height, false)?;
        let features: Vec<_> = self.weights.layers.taps(&records).map(compare::normalized).collect();
        if features.iter().flatten().any(|value| !value.is_finite()) {
            return Err(Error::FeaturesOverflow);
        }
        Ok(LpipsTarget { lpips: self.clone(), width, height, features })
    }

    /// The distance of two pictures; the order does not matter.
    ///
    /// # Errors
    /// As [`Lpips::target`], and if the sizes differ.
    pub fn distance(&self, a: &Image, b: &Image) -> Result<f64> {
        crate::check::same_size(a, b)?;
        self.target(b)?.distance(a.data())
    }

    /// The network's input and what its layers made of it.
    fn features(
        &self,
        name: &'static str,
        values: &[f32],
        width: usize,
        height: usize,
        keep: bool,
    ) -> Result<(Maps, Vec<Record>)> {
        moderate(name, values, width, height, self.minimum)?;
        let scaled = |(i, &value): (usize, &f32)| (2.0 * value - 1.0 - SHIFT[i % 3]) / SCALE[i % 3];
        let values = values.par_iter().enumerate().map(scaled).collect();
        let picture = Maps { values, height, width, channels: 3 };
        let records = self.weights.layers.run(&picture, keep);
        Ok((picture, records))
    }
}

impl LpipsTarget {
    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The distance of a picture `[height, width, 3]`.
    ///
    /// # Errors
    /// If its length does not fit, a value is not finite or beyond ±10⁶, or the features overflow.
    pub fn distance(&self, picture: &[f32]) -> Result<f64> {
        Ok(self.distances(picture)?.iter().sum())
    }

    /// The parts of [`LpipsTarget::distance`] by layer, near the picture first: five, or seven of SqueezeNet.
    ///
    /// # Errors
    /// As [`LpipsTarget::distance`].
    pub fn distances(&self, picture: &[f32]) -> Result<Vec<f64>> {
        let (_, records) = self.lpips.features("first", picture, self.width, self.height, false)?;
        self.compare(&records)
    }

    /// The distance of a picture `[height, width, 3]`, and its derivative by every value.
    ///
    /// The metric does not clip: a caller who clips colours masks the derivative where he has.
    ///
    /// # Errors
    /// As [`LpipsTarget::distance`].
    pub fn distance_and_gradient(&self, picture: &[f32]) -> Result<(f64, Vec<f32>)> {
        let (input, records) = self.lpips.features("fitted", picture, self.width, self.height, true)?;
        let distance = self.compare(&records)?.iter().sum();
        let Weights { layers, linear, .. } = &*self.lpips.weights;
        let parts = layers.taps(&records).zip(&self.features).zip(linear);
        let taps = parts.map(|((features, target), linear)| compare::gradient(features, target, linear));
        let taps = taps.collect();
        let mut gradient = layers.pull_back(&input, &records, taps).values;
        for (i, value) in gradient.iter_mut().enumerate() {
            *value *= 2.0 / SCALE[i % 3];
        }
        if gradient.iter().any(|value| !value.is_finite()) {
            return Err(Error::FeaturesOverflow);
        }
        Ok((distance, gradient))
    }

    fn compare(&self, records: &[Record]) -> Result<Vec<f64>> {
        let Weights { layers, linear, .. } = &*self.lpips.weights;
        let parts = layers.taps(records).zip(&self.features).zip(linear);
        let parts: Vec<f64> =
            parts.map(|((features, target), linear)| compare::distance(features, target, linear)).collect();
        if parts.iter().all(|part| part.is_finite()) { Ok(parts) } else { Err(Error::FeaturesOverflow) }
    }
}
