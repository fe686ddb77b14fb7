use crate::{Error, Result};
use std::ops::Range;

/// Columns of the geometry row that hold the mean, scene units.
pub const MEAN: Range<usize> = 0..3;
/// Columns of the geometry row that hold the rotation as a quaternion (w, x, y, z) of any non-zero norm.
pub const QUATERNION: Range<usize> = 3..7;
/// Columns of the geometry row that hold the natural logarithm of the three standard deviations, scene units.
pub const LOG_SCALE: Range<usize> = 7..10;
/// Column of the geometry row that holds the logit of the opacity.
pub const OPACITY_LOGIT: usize = 10;
/// The constant spherical harmonic, 1 / (2 √π).
pub const SH_C0: f32 = 0.282_094_8;

/// Coefficients per channel of spherical harmonics of a degree: (degree + 1)².
#[must_use]
pub const fn sh_coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Colour to the constant SH coefficient: (rgb - ½) / Y₀.
#[must_use]
pub fn dc_from_rgb(rgb: [f32; 3]) -> [f32; 3] {
    rgb.map(|c| (c - 0.5) / SH_C0)
}

/// The constant SH coefficient to colour: ½ + Y₀ · dc.
#[must_use]
pub fn rgb_from_dc(dc: [f32; 3]) -> [f32; 3] {
    dc.map(|c| 0.5 + SH_C0 * c)
}

/// The logistic function, stable for large arguments of either sign.
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The inverse of [`sigmoid`]; its argument must lie strictly between 0 and 1 to be finite.
#[must_use]
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// A set of N 3D Gaussians in the *stored* parametrisation of the 3DGS PLY: what files, optimisers and gradients
/// share. The renderer activates (exp, sigmoid) and normalises.
///
/// * geometry `[N, 11]` f32: [`MEAN`], [`QUATERNION`], [`LOG_SCALE`], [`OPACITY_LOGIT`];
/// * SH `[N, (degree+1)², 3]` f32, coefficient-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    sh_degree: usize,
    geometry: Vec<f32>,
    sh: Vec<f32>,
}

impl Gaussians {
    /// Numbers per Gaussian in the geometry buffer.
    pub const GEOMETRY: usize = 11;

    /// No Gaussians yet, of the given SH degree (0 to 3).
    ///
    /// # Errors
    /// If the degree is above 3.
    pub fn empty(sh_degree: usize) -> Result<Self> {
        Self::new(sh_degree, Vec::new(), Vec::new())
    }

    /// Gaussians from their buffers.
    ///
    /// # Errors
    /// If the degree is above 3 or a buffer's length does not fit the other's.
    pub fn new(sh_degree: usize, geometry: Vec<f32>, sh: Vec<f32>) -> Result<Self> {
        if sh_degree > 3 {
            return Err(Error::ShDegree { found: sh_degree });
        }
        let n = geometry.len() / Self::GEOMETRY;
        let lengths = [
            ("geometry", n * Self::GEOMETRY, geometry.len()),
            ("sh", n * sh_coefficients(sh_degree) * 3, sh.len()),
        ];
        for (what, expected, found) in lengths {
            if expected != found {
                return Err(Error::Length { what, expected, found });
            }
        }
        Ok(Self { sh_degree, geometry, sh })
    }

    /// Appends one Gaussian; `sh` is `[(degree+1)², 3]`.
    ///
    /// # Panics
    /// If `sh` does not have the length of this set's degree.
    pub fn push(
        &mut self,
        mean: [f32; 3],
        quaternion: [f32; 4],
        log_scale: [f32; 3],
        opacity_logit: f32,
        sh: &[f32],
    ) {
        assert_eq!(
            sh.len(),
            sh_coefficients(self.sh_degree) * 3,
            "SH coefficients of degree {}",
            self.sh_degree
        );
        self.geometry.extend_from_slice(&mean);
        self.geometry.extend_from_slice(&quaternion);
        self.geometry.extend_from_slice(&log_scale);
        self.geometry.push(opacity_logit);
        self.sh.extend_from_slice(sh);
    }

    /// Appends all Gaussians of another set.
    ///
    /// # Panics
    /// If the SH degrees differ.
    pub fn append(&mut self, other: &Self) {
        assert_eq!(self.sh_degree, other.sh_degree, "SH degrees of two sets to be joined");
        self.geometry.extend_from_slice(&other.geometry);
        self.sh.extend_from_slice(&other.sh);
    }

    /// Keeps the Gaussians for whose index `keep` is true, in their order; no buffer is given back.
    pub fn retain(&mut self, mut keep: impl FnMut(usize) -> bool) {
        let numbers = sh_coefficients(self.sh_degree) * 3;
        let mut kept = 0;
        for i in 0..self.len() {
            if keep(i) {
                self.geometry
                    .copy_within(i * Self::GEOMETRY..(i + 1) * Self::GEOMETRY, kept * Self::GEOMETRY);
                self.sh.copy_within(i * numbers..(i + 1) * numbers, kept * numbers);
                kept += 1;
            }
        }
        self.geometry.truncate(kept * Self::GEOMETRY);
        self.sh.truncate(kept * numbers);
    }

    /// The same Gaussians with SH coefficients up to `degree`, new ones 0; as they are if they have that many.
    ///
    /// # Errors
    /// If the degree is above 3.
    pub fn with_sh_degree(self, degree: usize) -> Result<Self> {
        if degree <= self.sh_degree {
            return Ok(self);
        }
        let (from, to) = (sh_coefficients(self.sh_degree) * 3, sh_coefficients(degree) * 3);
        let mut sh = vec![0.0; self.len() * to];
        for (new, old) in sh.chunks_exact_mut(to).zip(self.sh.chunks_exact(from)) {
            new[..from].copy_from_slice(old);
        }
        Self::new(degree, self.geometry, sh)
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.geometry.len() / Self::GEOMETRY
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.geometry.is_empty()
    }

    /// SH degree, 0 to 3.
    #[must_use]
    pub fn sh_degree(&self) -> usize {
        self.sh_degree
    }

    /// The geometry buffer, `[N, 11]`.
    #[must_use]
    pub fn geometry(&self) -> &[f32] {
        &self.geometry
    }

    /// The SH buffer, `[N, (degree+1)², 3]`.
    #[must_use]
    pub fn sh(&self) -> &[f32] {
        &self.sh
    }

    /// Both buffers, geometry and SH, to change in place.
    pub fn buffers_mut(&mut self) -> (&mut [f32], &mut [f32]) {
        (&mut self.geometry, &mut self.sh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_must_fit_each_other() {
        assert!(matches!(Gaussians::new(4, vec![], vec![]), Err(Error::ShDegree { found: 4 })));
        assert!(Gaussians::new(0, vec![0.0; 12], vec![0.0; 3]).is_err());
        assert!(Gaussians::new(1, vec![0.0; 11], vec![0.0; 3]).is_err());
        assert_eq!(Gaussians::new(1, vec![0.0; 22], vec![0.0; 24]).unwrap().len(), 2);
    }

    #[test]
    fn those_that_are_kept_stay_in_order() {
        let mut scene = Gaussians::empty(0).unwrap();
        for i in 0..5 {
            scene.push([i as f32; 3], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[i as f32; 3]);
        }
        scene.retain(|i| i % 2 == 0);
        let means: Vec<f32> = scene.geometry().chunks_exact(Gaussians::GEOMETRY).map(|row| row[0]).collect();
        assert_eq!(
            (means, scene.sh()),
            (vec![0.0, 2.0, 4.0], &[0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0][..])
        );
        scene.retain(|_| false);
        assert!(scene.is_empty() && scene.sh().is_empty());
    }

    #[test]
    fn activations_invert() {
        for p in [1e-6, 0.1, 0.5, 0.95] {
            assert!((sigmoid(logit(p)) - p).abs() < 1e-6);
        }
        assert_eq!((sigmoid(-1e4), sigmoid(1e4)), (0.0, 1.0));
        let rgb = [0.0, 0.3, 1.0];
        let back = rgb_from_dc(dc_from_rgb(rgb));
        assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
