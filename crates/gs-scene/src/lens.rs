//! The lens: a pinhole, and where a real lens puts what the pinhole would see.

use crate::Intrinsics;
use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

/// Distortion coefficients of OpenCV's model, without unit; all 0 for a pinhole.
///
/// A direction (x, y) = (X/Z, Y/Z) is seen at (x', y'), with r² = x² + y² and R = 1 + k1 r² + k2 r⁴ + k3 r⁶:
/// x' = x R + 2 p1 x y + p2 (r² + 2 x²), y' = y R + p1 (r² + 2 y²) + 2 p2 x y.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Radial, r⁶.
    pub k3: f64,
    /// Tangential, vertical.
    pub p1: f64,
    /// Tangential, horizontal.
    pub p2: f64,
}

impl Distortion {
    /// Whether every coefficient is 0.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        *self == Self::default()
    }

    /// Undistorted to distorted direction, and the Jacobian of that map. The Jacobian is symmetric.
    fn apply(&self, direction: DVec2) -> (DVec2, DMat2) {
        let Self { k1, k2, k3, p1, p2 } = *self;
        let DVec2 { x, y } = direction;
        let r2 = direction.length_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let tangential = DVec2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let off_diagonal = x * y * slope + 2.0 * (p1 * x + p2 * y);
        let jacobian = DMat2::from_cols_array(&[
            radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            off_diagonal,
            off_diagonal,
            radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        ]);
        (direction * radial + tangential, jacobian)
    }
}

/// Whether the distortion keeps its orientation in both axes, which makes it one-to-one: a map whose (symmetric)
/// Jacobian is positive definite throughout a convex region takes no two of its points to the same place.
fn is_positive_definite(jacobian: &DMat2) -> bool {
    jacobian.determinant() > 0.0 && jacobian.x_axis.x > 0.0
}

/// How a lens departs from a pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LensModel {
    /// OpenCV's radial and tangential distortion; a pinhole if all coefficients are 0.
    RadialTangential(Distortion),
}

impl Default for LensModel {
    fn default() -> Self {
        Self::PINHOLE
    }
}

impl From<Distortion> for LensModel {
    fn from(distortion: Distortion) -> Self {
        Self::RadialTangential(distortion)
    }
}

impl LensModel {
    /// No distortion.
    pub const PINHOLE: Self =
        Self::RadialTangential(Distortion { k1: 0.0, k2: 0.0, k3: 0.0, p1: 0.0, p2: 0.0 });

    /// Whether the model is a pinhole.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        *self == Self::PINHOLE
    }

    /// The coefficients, if the model is OpenCV's radial and tangential one.
    #[must_use]
    pub fn radial_tangential(&self) -> Option<&Distortion> {
        match self {
            Self::RadialTangential(distortion) => Some(distortion),
        }
    }

    fn apply(&self, direction: DVec2) -> (DVec2, DMat2) {
        match self {
            Self::RadialTangential(distortion) => distortion.apply(direction),
        }
    }
}

/// Intrinsics in pixels of a stated picture size, with lens distortion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Focal lengths, principal point and picture size, pixels.
    pub intrinsics: Intrinsics,
    /// How the lens departs from that pinhole.
    pub model: LensModel,
}

impl Lens {
    /// The pixel position at which the direction (X/Z, Y/Z) is seen.
    #[must_use]
    pub fn distort(&self, direction: DVec2) -> DVec2 {
        self.to_pixel(self.model.apply(direction).0)
    }

    /// As [`Lens::distort`], but `None` where the distortion is not one-to-one.
    #[must_use]
    pub fn distort_one_to_one(&self, direction: DVec2) -> Option<DVec2> {
        let (distorted, jacobian) = self.model.apply(direction);
        is_positive_definite(&jacobian).then(|| self.to_pixel(distorted))
    }

    /// The direction (X/Z, Y/Z) seen at a pixel position; `None` where the distortion has no inverse.
    #[must_use]
    pub fn undistort(&self, pixel: DVec2) -> Option<DVec2> {
        let seen = self.intrinsics.ray(pixel).truncate();
        if !seen.length().is_finite() {
            return None;
        }
        let mut direction = seen;
        let (mut distorted, mut jacobian) = self.model.apply(direction);
        if !is_positive_definite(&jacobian) {
            // The seen direction lies beyond a fold; the centre of the picture never does.
            direction = DVec2::ZERO;
            (distorted, jacobian) = self.model.apply(direction);
        }
        for _ in 0..MAX_NEWTON_STEPS {
            let residual = seen - distorted;
            if residual.length() <= 1e-15 * (1.0 + seen.length()) {
                break;
            }
            let mut step = jacobian.inverse() * residual;
            // A step over a fold, or one that leads away, is shortened.
            let (next, next_distorted, next_jacobian) = (0..MAX_HALVINGS).find_map(|_| {
                let next = direction + step;
                let (next_distorted, next_jacobian) = self.model.apply(next);
                let nearer = (seen - next_distorted).length() < residual.length();
                step *= 0.5;
                (nearer && is_positive_definite(&next_jacobian)).then_some((
                    next,
                    next_distorted,
                    next_jacobian,
                ))
            })?;
            (direction, distorted, jacobian) = (next, next_distorted, next_jacobian);
        }
        let found = (seen - distorted).length() <= 1e-12 * (1.0 + seen.length());
        found.then_some(direction)
    }

    fn to_pixel(self, direction: DVec2) -> DVec2 {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        DVec2::new(fx * direction.x + cx, fy * direction.y + cy)
    }

    /// The same lens for a picture of another size; `None` if its aspect ratio differs by more than 1 %.
    #[must_use]
    pub fn at_size(&self, width: usize, height: usize) -> Option<Self> {
        let stated = self.intrinsics;
        let (sx, sy) = (width as f64 / stated.width as f64, height as f64 / stated.height as f64);
        let agrees = (sx / sy - 1.0).abs() <= MAX_ASPECT_DEVIATION;
        agrees.then(|| Self { intrinsics: stated.resized(width, height), ..*self })
    }
}

/// Newton's method doubles the digits with each step; more than a handful means that there is no solution.
const MAX_NEWTON_STEPS: usize = 60;
const MAX_HALVINGS: usize = 40;
/// Thumbnails of odd-sized pictures are rounded to whole pixels; a crop or a rotation differs by more.
pub const MAX_ASPECT_DEVIATION: f64 = 0.01;
