//! The Gaussians of a tape, which are read again by the backward pass.

use crate::rasterize::{Arrays, Unbound};
use gs_raster::Activated;
use gs_scene::Gaussians;
use pyo3::exceptions::PyRuntimeError;
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
    /// The caller's arrays, and their fingerprint when they were drawn.
    InPlace(Unbound, u64),
}

/// [`Kept`], at hand.
pub(crate) enum Held<'py, 'a> {
    Stored(&'a Gaussians),
    Arrays(Arrays<'py>),
}

impl Kept {
    /// Makes the numbers readable.
    ///
    /// # Errors
    /// If the caller's arrays have another shape or layout by now, or other numbers.
    pub(crate) fn hold<'py>(&self, py: Python<'py>) -> PyResult<Held<'py, '_>> {
        match self {
            Self::Stored(gaussians) => Ok(Held::Stored(gaussians)),
            Self::InPlace(arrays, drawn) => {
                let arrays = arrays.bind(py)?;
                if fingerprint(&arrays.activated()?) != *drawn {
                    return Err(PyRuntimeError::new_err(
                        "the arrays were changed after record, which does not copy them: call backward before changing the arrays, or pass \
                         copies to record",
                    ));
                }
                Ok(Held::Arrays(arrays))
            }
        }
    }
}

impl Held<'_, '_> {
    /// The numbers in place.
    pub(crate) fn numbers(&self) -> PyResult<Numbers<'_>> {
        match self {
            Self::Stored(gaussians) => Ok(Numbers::Stored(gaussians)),
            Self::Arrays(arrays) => arrays.activated().map(Numbers::Activated),
        }
    }
}

/// A hash of some numbers of every array, in microseconds: 64 stretches of 16, and all of an array of up to 1024. A step that changes all
/// numbers changes it; one that changes a part of a large array may not.
pub(crate) fn fingerprint(arrays: &Activated<'_>) -> u64 {
    const STRETCH: usize = 16;
    const STRETCHES: usize = 64;
    let Activated { means, quats, scales, opacities, colors, .. } = arrays;
    let mut hash = 0u64;
    for array in [means, quats, scales, opacities, colors] {
        for part in array.chunks(array.len().div_ceil(STRETCHES).max(STRETCH)) {
            for number in &part[..part.len().min(STRETCH)] {
                // FNV-1a's prime; the rotation brings high bits down.
                hash = (hash.rotate_left(5) ^ u64::from(number.to_bits())).wrapping_mul(0x100_0000_01b3);
            }
        }
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_raster::Colors;

    #[test]
    fn a_fingerprint_changes_with_a_step_and_with_any_number_of_small_arrays() {
        let digest = |arrays: &[Vec<f32>; 5]| {
            let [means, quats, scales, opacities, colors] = arrays.each_ref().map(Vec::as_slice);
            fingerprint(&Activated { means, quats, scales, opacities, colors, kind: Colors::Rgb })
        };
        let arrays = |n: usize| [3, 4, 3, 1, 3].map(|width| vec![0.5f32; n * width]);
        let small = arrays(200);
        for array in 0..5 {
            for place in 0..small[array].len() {
                let mut changed = small.clone();
                changed[array][place] = 0.25;
                assert_ne!(digest(&small), digest(&changed), "{array} {place}");
            }
        }
        let large = arrays(50_000);
        for array in 0..5 {
            let mut stepped = large.clone();
            stepped[array].iter_mut().for_each(|number| *number += 1e-6);
            assert_ne!(digest(&large), digest(&stepped), "{array}");
        }
        digest(&arrays(0));
    }
}
