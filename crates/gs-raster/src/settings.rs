//! Settings of a rendering, and their limits.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// The most pairs of Gaussian and tile that are listed: 1 GiB of indices.
pub(crate) const INTERSECTIONS_MAX: u64 = 1 << 28;
/// The most pairs that are listed where gradients are to be summed by pair, at least ten numbers each: some 1 GiB of them.
pub(crate) const INTERSECTIONS_MAX_RECORDED: u64 = (1 << 28) / 10;

/// Size at which [`Style::Ellipsoids`] draws a Gaussian, standard deviations.
pub const ELLIPSOID_SIGMA: f32 = 1.0;
/// Gaussians less opaque than this are not drawn by [`Style::Ellipsoids`]: solid, they would hide what they do not hide.
pub const ELLIPSOID_OPACITY_MIN: f32 = 0.2;

/// The projection is linearised inside the image and this share of its size beyond each side, so that footprints of Gaussians
/// far outside stay small.
pub const SLOPE_MARGIN: f64 = 0.15;

/// Share of the colour that an ellipsoid keeps where it is seen edge-on.
pub(crate) const ELLIPSOID_AMBIENT: f32 = 0.3;

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// The Gaussians blended, as the camera sees the scene.
    #[default]
    Blended,
    /// Each Gaussian as a solid ellipsoid, lit from the camera: where they lie, how large they are and how they are turned. Its
    /// image is that of the affine projection which blending uses, low-pass filter included. Alpha is 1 or 0, depth that of
    /// the front; there are no gradients.
    Ellipsoids,
}

/// How to render. The defaults are the thresholds of the 3DGS family of renderers; the near plane must follow the
/// scale of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderSettings {
    /// What the picture shows. Default blended.
    pub style: Style,
    /// Colour behind everything. Default black.
    pub background: [f32; 3],
    /// Gaussians whose centre is at this z-depth or nearer are not drawn, scene units. Default 0.01.
    pub near: f32,
    /// Gaussians whose centre is at this z-depth or farther are not drawn, scene units. Default 1e10.
    pub far: f32,
    /// Compensate the opacity of Gaussians smaller than a pixel for the low-pass filter (Mip-Splatting, Yu et al.
    /// 2024, section 4.2). Default off.
    pub antialias: bool,
    /// Least factor of that compensation, so that tiny Gaussians do not vanish. Default 0.005.
    pub compensation_min: f32,
    /// Render the expected depth as well. Default off: it costs time.
    pub depth: bool,
    /// Largest opacity of one Gaussian in one pixel. Default 0.99.
    pub alpha_max: f32,
    /// Below this opacity in a pixel a Gaussian is not drawn there; it bounds the footprint. Default 1/255.
    pub alpha_min: f32,
    /// A pixel is done before the Gaussian that would take its transmittance below this. Default 1e-4.
    pub transmittance_min: f32,
    /// Variance of the low-pass filter added to every footprint, square pixels. Default 0.3.
    pub eps2d: f32,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            style: Style::Blended,
            background: [0.0; 3],
            near: 0.01,
            far: 1e10,
            antialias: false,
            compensation_min: 0.005,
            depth: false,
            alpha_max: 0.99,
            alpha_min: 1.0 / 255.0,
            transmittance_min: 1e-4,
            eps2d: 0.3,
        }
    }
}

impl RenderSettings {
    /// Whether every setting lies in its range; the comparisons are written so that NaN fails them.
    pub(crate) fn check(&self) -> Result<()> {
        let finite = self.background.iter().find(|value| !value.is_finite());
        if let Some(&found) = finite {
            return Err(Error::Setting { name: "background", found, expected: "finite numbers" });
        }
        let rules = [
            ("near", self.near, self.near >= 0.0 && self.near.is_finite(), "a finite number of at least 0"),
            ("far", self.far, self.far > self.near, "a number above near"),
            (
                "alpha_min",
                self.alpha_min,
                (1e-6..1.0).contains(&self.alpha_min),
                "a number from 1e-6 to below 1",
            ),
            (
                "alpha_max",
                self.alpha_max,
                self.alpha_max >= self.alpha_min && self.alpha_max < 1.0,
                "a number from alpha_min to below 1",
            ),
            (
                "transmittance_min",
                self.transmittance_min,
                (1e-20..1.0).contains(&self.transmittance_min),
                "a number from 1e-20 to below 1",
            ),
            ("eps2d", self.eps2d, (1e-6..1e6).contains(&self.eps2d), "a number from 1e-6 to 1e6"),
        ];
        let rules = rules.into_iter().chain([(
            "compensation_min",
            self.compensation_min,
            (0.0..=1.0).contains(&self.compensation_min),
            "a number from 0 to 1",
        )]);
        for (name, found, in_range, expected) in rules {
            if !in_range {
                return Err(Error::Setting { name, found, expected });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_every_range_is_checked() {
        let good = RenderSettings::default();
        assert!(good.check().is_ok());
        let nan = f32::NAN;
        let bad = [
            ("background", RenderSettings { background: [0.0, nan, 0.0], ..good }),
            ("near", RenderSettings { near: nan, ..good }),
            ("near", RenderSettings { near: -1.0, ..good }),
            ("far", RenderSettings { far: 0.01, ..good }),
            ("far", RenderSettings { far: nan, ..good }),
            ("alpha_min", RenderSettings { alpha_min: 0.0, ..good }),
            ("alpha_max", RenderSettings { alpha_max: 1.0, ..good }),
            ("alpha_max", RenderSettings { alpha_max: 0.001, ..good }),
            ("transmittance_min", RenderSettings { transmittance_min: 0.0, ..good }),
            ("eps2d", RenderSettings { eps2d: 0.0, ..good }),
            ("compensation_min", RenderSettings { compensation_min: nan, ..good }),
        ];
        for (expected, settings) in bad {
            match settings.check() {
                Err(Error::Setting { name, .. }) => assert_eq!(name, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
