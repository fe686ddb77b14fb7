//! The Gaussians of a tape, which are read again by the backward pass.

use crate::engine::Engine;
use crate::rasterize::{Arrays, Unbound};
use gs_raster::{Activated, Colors};
use gs_scene::Gaussians;
use pyo3::prelude::*;
use std::sync::Arc;

/// Gaussians to be drawn.
#[derive(Clone, Copy)]
pub(crate) enum Numbers<'a> {
    Stored(&'a Gaussians),
    Activated(Activated<'a>),
}

impl Numbers<'_> {
    /// Number of Gaussians.
    pub(crate) fn len(self) -> usize {
        match self {
            Self::Stored(gaussians) => gaussians.len(),
            Self::Activated(arrays) => arrays.len(),
        }
    }
}

/// Where the Gaussians of a tape are.
pub(crate) enum Kept {
    /// Stored ones, shared with a scene.
    Stored(Arc<Gaussians>),
    /// A copy of arrays.
    Copy(Copied),
    /// The caller's arrays.
    InPlace(Unbound),
}

/// [`Kept`], at hand.
pub(crate) enum Held<'py, 'a> {
    Numbers(Numbers<'a>),
    Arrays(Arrays<'py>),
}

impl Kept {
    /// Makes the numbers readable.
    ///
    /// # Errors
    /// If the caller's arrays have another shape or layout by now.
    pub(crate) fn hold<'py>(&self, py: Python<'py>) -> PyResult<Held<'py, '_>> {
        Ok(match self {
            Self::Stored(gaussians) => Held::Numbers(Numbers::Stored(gaussians)),
            Self::Copy(copied) => Held::Numbers(Numbers::Activated(copied.activated())),
            Self::InPlace(arrays) => Held::Arrays(arrays.bind(py)?),
        })
    }
}

impl Held<'_, '_> {
    /// The numbers in place.
    pub(crate) fn numbers(&self) -> PyResult<Numbers<'_>> {
        match self {
            Self::Numbers(numbers) => Ok(*numbers),
            Self::Arrays(arrays) => arrays.activated().map(Numbers::Activated),
        }
    }
}

/// A copy of activated Gaussians.
pub(crate) struct Copied {
    means: Vec<f32>,
    quats: Vec<f32>,
    scales: Vec<f32>,
    opacities: Vec<f32>,
    colors: Vec<f32>,
    kind: Colors,
}

impl Copied {
    /// A copy in spare buffers of the engine.
    pub(crate) fn of(arrays: &Activated<'_>, engine: &Engine) -> Self {
        let Activated { means, quats, scales, opacities, colors, kind } = *arrays;
        Self {
            means: engine.copy(means),
            quats: engine.copy(quats),
            scales: engine.copy(scales),
            opacities: engine.copy(opacities),
            colors: engine.copy(colors),
            kind,
        }
    }

    /// Gives the buffers back.
    pub(crate) fn recycle(self, engine: &Engine) {
        engine.recycle([self.means, self.quats, self.scales, self.opacities, self.colors]);
    }

    fn activated(&self) -> Activated<'_> {
        let Self { means, quats, scales, opacities, colors, kind } = self;
        Activated { means, quats, scales, opacities, colors, kind: *kind }
    }
}
