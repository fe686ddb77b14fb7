//! Profiles: the thresholds in which renderers of this family differ.

use glam::DVec3;

/// What renderers of this family disagree in. The default is the reference profile, in which every
/// number is rounded to f32 first, so that f32 and f64 programs take their decisions at the same thresholds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// Gaussians at this z-depth or nearer are not drawn, scene units.
    pub near: f64,
    /// Gaussians at this z-depth or farther are not drawn, scene units.
    pub far: f64,
    /// Variance of the low-pass filter, square pixels.
    pub eps2d: f64,
    /// Largest opacity in a pixel.
    pub alpha_max: f64,
    /// Smallest opacity that is drawn in a pixel.
    pub alpha_min: f64,
    /// A pixel stops before the Gaussian that takes its transmittance below this.
    pub transmittance_min: f64,
    /// Whether opacity is compensated for the low-pass filter (Mip-Splatting).
    pub antialias: bool,
    /// Least factor of that compensation.
    pub compensation_min: f64,
    /// Axes in which the spherical harmonics are evaluated.
    pub sh_axes: ShAxes,
}

/// Axes in which the basis of the spherical harmonics is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShAxes {
    /// The world's (x, y, z).
    Standard,
    /// (z, x, y), as renderers do whose coefficients follow e3nn.
    E3nn,
}

impl ShAxes {
    /// The coordinates of a direction of the world along these axes.
    pub(crate) fn coordinates(self, d: DVec3) -> DVec3 {
        match self {
            Self::Standard => d,
            Self::E3nn => DVec3::new(d.z, d.x, d.y),
        }
    }

    /// The inverse of [`ShAxes::coordinates`].
    pub(crate) fn to_world(self, d: DVec3) -> DVec3 {
        match self {
            Self::Standard => d,
            Self::E3nn => DVec3::new(d.y, d.z, d.x),
        }
    }
}

impl Default for Profile {
    fn default() -> Self {
        Self {
            near: f64::from(0.2f32),
            far: f64::from(1e10f32),
            eps2d: f64::from(0.3f32),
            alpha_max: f64::from(0.99f32),
            alpha_min: f64::from(1.0f32 / 255.0),
            transmittance_min: f64::from(1e-4f32),
            antialias: false,
            compensation_min: f64::from(0.005f32),
            sh_axes: ShAxes::Standard,
        }
    }
}
