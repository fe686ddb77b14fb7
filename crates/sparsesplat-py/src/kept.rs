//! The Gaussians of a tape, which are read again by the backward pass.

use crate::engine::Engine;
use crate::rasterize::{Arrays, Unbound};
use gs_raster::{Activated, Colors};
use gs_scene::Gaussians;
use pyo3::prelude::*;
use rayon::prelude::*;
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
    /// A copy, in memory of a former one of the same size if there is any.
    pub(crate) fn of(arrays: &Activated<'_>, engine: &Engine) -> Self {
        let Activated { means, quats, scales, opacities, colors, kind } = *arrays;
        let mut copied = engine.spare(|spare| spare.fits(arrays)).unwrap_or_else(|| Self {
            means: vec![0.0; means.len()],
            quats: vec![0.0; quats.len()],
            scales: vec![0.0; scales.len()],
            opacities: vec![0.0; opacities.len()],
            colors: vec![0.0; colors.len()],
            kind,
        });
        copied.kind = kind;
        copy(&mut copied.colors, colors);
        copy(&mut copied.means, means);
        copy(&mut copied.quats, quats);
        copy(&mut copied.scales, scales);
        copy(&mut copied.opacities, opacities);
        copied
    }

    fn fits(&self, arrays: &Activated<'_>) -> bool {
        (self.opacities.len(), self.colors.len()) == (arrays.opacities.len(), arrays.colors.len())
    }

    fn activated(&self) -> Activated<'_> {
        let Self { means, quats, scales, opacities, colors, kind } = self;
        Activated { means, quats, scales, opacities, colors, kind: *kind }
    }
}

/// Copies numbers on all threads.
pub(crate) fn copy(to: &mut [f32], from: &[f32]) {
    const CHUNK: usize = 1 << 14;
    to.par_chunks_mut(CHUNK).zip(from.par_chunks(CHUNK)).for_each(|(to, from)| to.copy_from_slice(from));
}
