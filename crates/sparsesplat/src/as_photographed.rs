//! Exposure that changes with the view, as it does from photograph to photograph.
//!
//! Photographs that were taken side by side have similar exposure. So the scene keeps the exposure of the photographs and blends between them as
//! the viewpoint moves (the gain: docs/journal/2026-11-training-runs.md).
//!
//! For each Gaussian, δ_c = (rgb - bias_c) / gain_c - rgb is the change of its constant colour rgb from the common exposure to the photograph of
//! camera c. It is fitted over the directions d_c in which the cameras see the Gaussian: s minimises Σ_c (Y(d_c)·s - δ_c)² + λ |s|².

use crate::harmonics::{DEGREE, TERMS, basis};
use crate::{Exposure, ExposureGain, Result};
use glam::DVec3;
use gs_scene::{Gaussians, MEAN, View, rgb_from_dc, sh_coefficients};
use rayon::prelude::*;

/// λ. From 0.02 to 0.04 held-out photographs do not change by 0.01 dB (docs/journal/2026-11-exposure.md); a larger one bounds the change better in directions that no
/// photograph has: |Y·s| ≤ |Y| |δ| / (2 √λ).
const RIDGE: f64 = 0.04;
/// A gain below this, which no photograph of a scene has beside the others, is taken for this.
const SMALLEST_GAIN: f64 = 0.1;
/// Gaussians per parallel task.
const CHUNK: usize = 1024;

/// A photograph's colour less that in the common exposure, as a function of the latter: factor and offset.
pub(crate) type Change = [f64; 2];

/// The Gaussians, given in the common exposure, in the `wanted` one; as they are where that is the same or the views do not differ,
/// else of SH degree 2 or more. `exposure` is what brought each view into the common one.
pub(crate) fn exposed_as(
    wanted: Exposure,
    gaussians: Gaussians,
    views: &[View],
    exposure: &[ExposureGain],
) -> Result<Gaussians> {
    if wanted == Exposure::Common || exposure.iter().all(|&view| view == ExposureGain::NONE) {
        return Ok(gaussians);
    }
    let seen: Vec<(DVec3, Change)> = views
        .iter()
        .zip(exposure)
        .map(|(view, &exposure)| (view.camera().position(), change(exposure)))
        .collect();
    let mut gaussians = gaussians.with_sh_degree(DEGREE)?;
    let row = 3 * sh_coefficients(gaussians.sh_degree());
    let (geometry, sh) = gaussians.buffers_mut();
    let chunks = sh.par_chunks_mut(CHUNK * row).zip(geometry.par_chunks(CHUNK * Gaussians::GEOMETRY));
    chunks.for_each(|(sh, geometry)| {
        for (sh, geometry) in sh.chunks_exact_mut(row).zip(geometry.chunks_exact(Gaussians::GEOMETRY)) {
            let mean = DVec3::from(std::array::from_fn(|axis| f64::from(geometry[MEAN.start + axis])));
            let [factors, offsets] = fit(mean, &seen);
            let colour = rgb_from_dc([sh[0], sh[1], sh[2]]);
            for ((rgb, factor), offset) in sh.chunks_exact_mut(3).zip(factors).zip(offsets) {
                for (value, colour) in rgb.iter_mut().zip(colour) {
                    *value += (factor * f64::from(colour) + offset) as f32;
                }
            }
        }
    });
    Ok(gaussians)
}

/// What turns a colour in the common exposure into that of the photograph.
pub(crate) fn change(ExposureGain { gain, bias }: ExposureGain) -> Change {
    let gain = f64::from(gain).max(SMALLEST_GAIN);
    [1.0 / gain - 1.0, -f64::from(bias) / gain]
}

/// SH coefficients of the change's factor and of its offset, for a Gaussian at `mean`; `seen` are places and changes of the cameras.
fn fit(mean: DVec3, seen: &[(DVec3, Change)]) -> [[f64; TERMS]; 2] {
    let mut matrix = [[0.0; TERMS]; TERMS];
    let mut right = [[0.0; TERMS]; 2];
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] = RIDGE;
    }
    for &(eye, change) in seen {
        // From within the Gaussian there is no direction.
        let Some(direction) = (mean - eye).try_normalize() else { continue };
        let basis = basis(direction);
        for (row, y) in matrix.iter_mut().zip(basis) {
            row.iter_mut().zip(basis).for_each(|(entry, other)| *entry += y * other);
        }
        for (part, change) in right.iter_mut().zip(change) {
            part.iter_mut().zip(basis).for_each(|(entry, y)| *entry += y * change);
        }
    }
    decompose(&mut matrix);
    right.map(|part| solve(&matrix, part))
}

/// Cholesky's decomposition of a positive definite matrix: its lower triangle becomes L with A = L Lᵀ.
fn decompose(a: &mut [[f64; TERMS]; TERMS]) {
    for j in 0..TERMS {
        for i in j..TERMS {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] -= dot;
        }
        let pivot = a[j][j].sqrt();
        a[j..].iter_mut().for_each(|row| row[j] /= pivot);
    }
}

/// x with L Lᵀ x = b.
fn solve(l: &[[f64; TERMS]; TERMS], mut b: [f64; TERMS]) -> [f64; TERMS] {
    for i in 0..TERMS {
        let dot: f64 = (0..i).map(|k| l[i][k] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i][i];
    }
    for i in (0..TERMS).rev() {
        let dot: f64 = (i + 1..TERMS).map(|k| l[k][i] * b[k]).sum();
        b[i] = (b[i] - dot) / l[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn dot(basis: [f64; TERMS], coefficients: [f64; TERMS]) -> f64 {
        basis.iter().zip(coefficients).map(|(y, s)| y * s).sum()
    }

    proptest! {
        #[test]
        fn the_fit_is_the_minimum_and_bounded_everywhere(
            cameras in prop::collection::vec(
                (prop::array::uniform3(-3.0f64..3.0), prop::array::uniform2(-0.5f64..0.5)), 0..9),
            mean in prop::array::uniform3(-1.0f64..1.0), towards in prop::array::uniform3(-1.0f64..1.0),
        ) {
            let mean = DVec3::from(mean);
            let seen: Vec<(DVec3, Change)> = cameras.into_iter().map(|(eye, change)| (eye.into(), change)).collect();
            let found = fit(mean, &seen);
            for (part, found) in found.into_iter().enumerate() {
                // The derivative of what is minimised.
                let mut slope = found.map(|s| RIDGE * s);
                for (eye, change) in &seen {
                    let basis = basis((mean - *eye).normalize());
                    let error = dot(basis, found) - change[part];
                    slope.iter_mut().zip(basis).for_each(|(slope, y)| *slope += error * y);
                }
                prop_assert!(slope.iter().all(|slope| slope.abs() < 1e-10), "{slope:?}");
                let towards = basis(DVec3::from(towards).try_normalize().unwrap_or(DVec3::X));
                let (of_basis, of_changes) = (
                    towards.iter().map(|y| y * y).sum::<f64>(),
                    seen.iter().map(|(_, change)| change[part].powi(2)).sum::<f64>(),
                );
                let bound = (of_basis * of_changes / RIDGE).sqrt() / 2.0;
                prop_assert!(dot(towards, found).abs() <= bound + 1e-9);
            }
        }
    }

    #[test]
    fn a_camera_within_the_gaussian_and_absurd_exposures_are_defined() {
        let views: Vec<View> = [DVec3::ZERO, DVec3::X].map(view_from).into();
        let mut one = Gaussians::empty(0).unwrap();
        one.push([0.0; 3], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.3; 3]);
        for gain in [0.0, -1.0, 1e-30, f32::MAX] {
            let exposure = [ExposureGain { gain, bias: 0.5 }, ExposureGain { gain: 1.0, bias: -0.5 }];
            let changed = exposed_as(Exposure::AsPhotographed, one.clone(), &views, &exposure).unwrap();
            assert_eq!(changed.sh_degree(), DEGREE);
            assert!(
                changed.sh().iter().all(|v| v.is_finite() && v.abs() < 20.0),
                "{gain}: {:?}",
                changed.sh()
            );
        }
        let differing = [ExposureGain { gain: 2.0, bias: 0.0 }, ExposureGain::NONE];
        for (wanted, exposure) in
            [(Exposure::AsPhotographed, [ExposureGain::NONE; 2]), (Exposure::Common, differing)]
        {
            let same = exposed_as(wanted, one.clone(), &views, &exposure).unwrap();
            assert_eq!((same.sh_degree(), same.sh()), (0, one.sh()));
        }
    }

    fn view_from(eye: DVec3) -> View {
        let lens = gs_scene::Intrinsics { fx: 2.0, fy: 2.0, cx: 1.0, cy: 1.0, width: 2, height: 2 };
        let camera = gs_scene::Camera::new(lens, glam::DMat3::IDENTITY, -eye).unwrap();
        View::new("v", gs_scene::Image::filled(2, 2, [0.5; 3]).unwrap(), camera, None).unwrap()
    }
}
