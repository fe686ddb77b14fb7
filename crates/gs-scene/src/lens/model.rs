//! Lens models: the distortion of a pinhole picture.
//!
//! Every model has two steps. Its *projection* takes a direction (X/Z, Y/Z) to a plane: as it is, by its angle, or by
//! one of a few functions of its length that have closed inverses. Its *bending* then moves points within that plane,
//! by polynomials. The formulas are those of COLMAP (`src/colmap/sensor/models.h`), whose names the variants give.

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
    pub(super) fn apply(&self, direction: DVec2) -> (DVec2, DMat2) {
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

/// How a lens departs from a pinhole. Coefficients are without unit, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LensModel {
    /// OpenCV's radial and tangential distortion; a pinhole if all coefficients are 0. COLMAP's SIMPLE_PINHOLE,
    /// PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV.
    RadialTangential(Distortion),
    /// OpenCV's rational model, COLMAP's FULL_OPENCV: R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶).
    Rational {
        /// k1 to k6.
        k: [f64; 6],
        /// Tangential: p1 vertical, p2 horizontal, as in [`Distortion`].
        p: [f64; 2],
    },
    /// Equidistant projection, then R = 1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸. COLMAP's SIMPLE_FISHEYE, FISHEYE,
    /// SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, OPENCV_FISHEYE.
    Fisheye {
        /// k1 to k4.
        k: [f64; 4],
    },
    /// As `Fisheye`, with tangential distortion and a thin prism: x' += sx θ², y' += sy θ².
    ThinPrismFisheye {
        /// k1 to k4.
        k: [f64; 4],
        /// Tangential: p1, p2.
        p: [f64; 2],
        /// Prism: sx, sy.
        s: [f64; 2],
    },
    /// Equidistant projection, R to θ¹², then, at the place that this gives, tangential distortion and a prism
    /// x' += s0 r² + s1 r⁴, y' += s2 r² + s3 r⁴. COLMAP's RAD_TAN_THIN_PRISM_FISHEYE.
    RadTanThinPrismFisheye {
        /// k0 to k5.
        k: [f64; 6],
        /// Tangential: p0 horizontal, p1 vertical (the other way round than in OpenCV).
        p: [f64; 2],
        /// Prism: s0 to s3.
        s: [f64; 4],
    },
    /// r' = atan(2 r tan(ω/2)) / ω. COLMAP's FOV.
    Fov {
        /// Field of view that the model is named after, in (0, π).
        omega: f64,
    },
    /// r = r' / (1 + k r'²). COLMAP's SIMPLE_DIVISION, DIVISION.
    Division {
        /// The coefficient.
        k: f64,
    },
    /// r' = r / (α √(β r² + 1) + 1 - α), the extended unified model. COLMAP's EUCM.
    ExtendedUnified {
        /// From 0 (pinhole) to 1.
        alpha: f64,
        /// Above 0.
        beta: f64,
    },
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

    /// Whether the model can see half of all directions and more, which no pinhole picture can show.
    #[must_use]
    pub fn is_wide(&self) -> bool {
        !matches!(self, Self::RadialTangential(_) | Self::Rational { .. })
    }

    /// The coefficients, if the model is OpenCV's radial and tangential one.
    #[must_use]
    pub fn radial_tangential(&self) -> Option<&Distortion> {
        match self {
            Self::RadialTangential(distortion) => Some(distortion),
            _ => None,
        }
    }

    /// Whether every coefficient is finite and in its range.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        match self {
            Self::RadialTangential(Distortion { k1, k2, k3, p1, p2 }) => finite(&[*k1, *k2, *k3, *p1, *p2]),
            Self::Rational { k, p } => finite(k) && finite(p),
            Self::Fisheye { k } => finite(k),
            Self::ThinPrismFisheye { k, p, s } => finite(k) && finite(p) && finite(s),
            Self::RadTanThinPrismFisheye { k, p, s } => finite(k) && finite(p) && finite(s),
            Self::Fov { omega } => *omega > 0.0 && *omega < std::f64::consts::PI,
            Self::Division { k } => k.is_finite(),
            Self::ExtendedUnified { alpha, beta } => {
                (0.0..=1.0).contains(alpha) && *beta > 0.0 && beta.is_finite()
            }
        }
    }

    /// Direction to plane; NaN where the lens sees nothing.
    pub(super) fn project(&self, direction: DVec2) -> DVec2 {
        let r = direction.length();
        match *self {
            Self::RadialTangential(_) | Self::Rational { .. } => direction,
            Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } | Self::RadTanThinPrismFisheye { .. } => {
                direction * ratio(r.atan(), r)
            }
            Self::Fov { omega } => {
                let spread = 2.0 * (0.5 * omega).tan();
                direction * (ratio((r * spread).atan(), r * spread) * spread / omega)
            }
            // Beyond r = 1 / (2 √k) the root is NaN.
            Self::Division { k } => direction * (2.0 / (1.0 + (1.0 - 4.0 * k * r * r).sqrt())),
            Self::ExtendedUnified { alpha, beta } => {
                direction / (alpha * (beta * r * r + 1.0).sqrt() + 1.0 - alpha)
            }
        }
    }

    /// Plane to direction, the inverse of [`LensModel::project`]; `None` if nothing in front of the camera is seen
    /// there.
    pub(super) fn unproject(&self, seen: DVec2) -> Option<DVec2> {
        let r = seen.length();
        match *self {
            Self::RadialTangential(_) | Self::Rational { .. } => Some(seen),
            Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } | Self::RadTanThinPrismFisheye { .. } => {
                (r < std::f64::consts::FRAC_PI_2).then(|| seen * ratio(r.tan(), r))
            }
            Self::Fov { omega } => {
                let spread = 2.0 * (0.5 * omega).tan();
                let angle = r * omega;
                (angle < std::f64::consts::FRAC_PI_2)
                    .then(|| seen * (ratio(angle.tan(), angle) * omega / spread))
            }
            Self::Division { k } => {
                // For k > 0 the map turns back at r' = 1/√k, for k < 0 the direction is infinite there.
                (k.abs() * r * r < 1.0).then(|| seen / (1.0 + k * r * r))
            }
            Self::ExtendedUnified { alpha, beta } => {
                let root = 1.0 - (2.0 * alpha - 1.0) * beta * r * r;
                let z = (1.0 - alpha * alpha * beta * r * r) / (alpha * root.sqrt() + 1.0 - alpha);
                (root >= 0.0 && z > 0.0).then(|| seen / z)
            }
        }
    }

    /// Moves a point of the plane; the second value is the Jacobian.
    pub(super) fn bend(&self, point: DVec2) -> (DVec2, DMat2) {
        match self {
            Self::RadialTangential(distortion) => distortion.apply(point),
            Self::Rational { k, p } => {
                let (radial, by_radial) = radially(point, &k[..3], &k[3..]);
                let (shift, by_shift) = decentred(point, *p, [0.0; 4]);
                (radial + shift, by_radial + by_shift)
            }
            Self::Fisheye { k } => radially(point, k, &[]),
            Self::ThinPrismFisheye { k, p, s } => {
                let (radial, by_radial) = radially(point, k, &[]);
                let (shift, by_shift) = decentred(point, *p, [s[0], 0.0, s[1], 0.0]);
                (radial + shift, by_radial + by_shift)
            }
            Self::RadTanThinPrismFisheye { k, p, s } => {
                let (radial, by_radial) = radially(point, k, &[]);
                let (shift, by_shift) = decentred(radial, [p[1], p[0]], *s);
                (radial + shift, (DMat2::IDENTITY + by_shift) * by_radial)
            }
            Self::Fov { .. } | Self::Division { .. } | Self::ExtendedUnified { .. } => {
                (point, DMat2::IDENTITY)
            }
        }
    }
}

/// `a / b`, which tends to 1 where both vanish.
fn ratio(a: f64, b: f64) -> f64 {
    if b == 0.0 { 1.0 } else { a / b }
}

/// `point · R` with R = (1 + n1 r² + n2 r⁴ + ..) / (1 + d1 r² + ..), NaN where the denominator is not above 0.
fn radially(point: DVec2, numerator: &[f64], denominator: &[f64]) -> (DVec2, DMat2) {
    let r2 = point.length_squared();
    // Value and derivative by r² of 1 + c1 r² + c2 r⁴ + ..
    let polynomial = |coefficients: &[f64]| {
        let step = |(value, slope): (f64, f64), c: &f64| (value * r2 + c, slope * r2 + value);
        let (value, slope) = coefficients.iter().rev().fold((0.0, 0.0), step);
        (1.0 + r2 * value, value + r2 * slope)
    };
    let ((n, n_slope), (d, d_slope)) = (polynomial(numerator), polynomial(denominator));
    let radial = if d > 0.0 { n / d } else { f64::NAN };
    let slope = 2.0 * (n_slope - radial * d_slope) / d;
    let outer = DMat2::from_cols(point * point.x, point * point.y);
    (point * radial, DMat2::from_diagonal(DVec2::splat(radial)) + outer * slope)
}

/// The shift by tangential distortion p1, p2 and a prism s: (s0 r² + s1 r⁴, s2 r² + s3 r⁴).
fn decentred(point: DVec2, [p1, p2]: [f64; 2], s: [f64; 4]) -> (DVec2, DMat2) {
    let DVec2 { x, y } = point;
    let r2 = point.length_squared();
    let shift = DVec2::new(
        2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s[0] + r2 * s[1]),
        p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s[2] + r2 * s[3]),
    );
    let tangential = 2.0 * (p1 * x + p2 * y);
    let prism = DVec2::new(s[0] + 2.0 * r2 * s[1], s[2] + 2.0 * r2 * s[3]) * 2.0;
    let jacobian = DMat2::from_cols(
        DVec2::new(2.0 * p1 * y + 6.0 * p2 * x, tangential) + prism * x,
        DVec2::new(tangential, 6.0 * p1 * y + 2.0 * p2 * x) + prism * y,
    );
    (shift, jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_model() -> impl Strategy<Value = LensModel> {
        let small = -0.05..0.05f64;
        let coefficients = prop::array::uniform12(small);
        (0..8, coefficients, 0.1..0.9f64).prop_map(|(kind, c, share)| {
            let (k, p, s) = ([c[0], c[1], c[2], c[3]], [c[4] * 0.1, c[5] * 0.1], [c[6], c[7], c[8], c[9]]);
            let s = s.map(|s| s * 0.1);
            let k6 = [c[0], c[1], c[2], c[3], c[10], c[11]];
            match kind {
                0 => LensModel::from(Distortion { k1: c[0], k2: c[1], k3: c[2], p1: p[0], p2: p[1] }),
                1 => LensModel::Rational { k: k6, p },
                2 => LensModel::Fisheye { k },
                3 => LensModel::ThinPrismFisheye { k, p, s: [s[0], s[1]] },
                4 => LensModel::RadTanThinPrismFisheye { k: k6, p, s },
                5 => LensModel::Fov { omega: share * 2.0 },
                // The lens sees no direction beyond 1 / (2 √k): 3.5.
                6 => LensModel::Division { k: c[0] * 0.4 },
                _ => LensModel::ExtendedUnified { alpha: share, beta: 0.5 + share },
            }
        })
    }

    proptest! {
        #[test]
        fn projection_has_its_inverse(model in any_model(), x in -2.0..2.0f64, y in -2.0..2.0f64) {
            let direction = DVec2::new(x, y);
            let plane = model.project(direction);
            let back = model.unproject(plane).unwrap();
            prop_assert!((back - direction).length() < 1e-12 * (1.0 + x * x + y * y), "{model:?} {plane} {back}");
        }

        #[test]
        fn the_jacobian_is_the_derivative(model in any_model(), x in -0.7..0.7f64, y in -0.7..0.7f64) {
            let (point, step) = (DVec2::new(x, y), 1e-5);
            let (_, jacobian) = model.bend(point);
            for (column, axis) in [(jacobian.x_axis, DVec2::X), (jacobian.y_axis, DVec2::Y)] {
                let (ahead, behind) = (model.bend(point + axis * step).0, model.bend(point - axis * step).0);
                // Central differences: 1e-9 from the third derivative, 1e-11 from rounding.
                prop_assert!(((ahead - behind) / (2.0 * step) - column).length() < 1e-7, "{model:?}");
            }
        }
    }
}
