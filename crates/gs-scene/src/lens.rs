//! The lens: a pinhole camera and its distortion.

mod model;

use crate::Intrinsics;
use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

pub use model::{Distortion, LensModel};

/// Whether a map keeps its orientation in all directions, which makes it one-to-one: one whose Jacobian has a positive
/// definite symmetric part throughout a convex region takes no two of its points to the same place.
fn is_positive_definite(jacobian: &DMat2) -> bool {
    let across = 0.5 * (jacobian.x_axis.y + jacobian.y_axis.x);
    jacobian.x_axis.x > 0.0 && jacobian.x_axis.x * jacobian.y_axis.y > across * across
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
    /// The pixel position at which the direction (X/Z, Y/Z) is seen; NaN where the lens sees nothing.
    #[must_use]
    pub fn distort(&self, direction: DVec2) -> DVec2 {
        self.to_pixel(self.model.bend(self.model.project(direction)).0)
    }

    /// As [`Lens::distort`], but `None` where the distortion is not one-to-one.
    #[must_use]
    pub fn distort_one_to_one(&self, direction: DVec2) -> Option<DVec2> {
        let (distorted, jacobian) = self.model.bend(self.model.project(direction));
        is_positive_definite(&jacobian).then(|| self.to_pixel(distorted))
    }

    /// The direction (X/Z, Y/Z) seen at a pixel position; `None` where the distortion has no inverse,
    /// or a wide lens looks sideways or backwards.
    #[must_use]
    pub fn undistort(&self, pixel: DVec2) -> Option<DVec2> {
        let seen = self.intrinsics.ray(pixel).truncate();
        if !seen.length().is_finite() {
            return None;
        }
        let mut point = seen;
        let (mut distorted, mut jacobian) = self.model.bend(point);
        if !is_positive_definite(&jacobian) {
            // The seen point lies beyond a fold; the centre of the picture never does.
            point = DVec2::ZERO;
            (distorted, jacobian) = self.model.bend(point);
        }
        for _ in 0..MAX_NEWTON_STEPS {
            let residual = seen - distorted;
            if residual.length() <= 1e-15 * (1.0 + seen.length()) {
                break;
            }
            let mut step = jacobian.inverse() * residual;
            // A step over a fold, or one that leads away, is shortened.
            let better = (0..MAX_HALVINGS).find_map(|_| {
                let next = point + step;
                let (next_distorted, next_jacobian) = self.model.bend(next);
                let nearer = (seen - next_distorted).length() < residual.length();
                step *= 0.5;
                (nearer && is_positive_definite(&next_jacobian)).then_some((
                    next,
                    next_distorted,
                    next_jacobian,
                ))
            });
            // Where no step helps, rounding or a fold ends the way.
            let Some(better) = better else { break };
            (point, distorted, jacobian) = better;
        }
        let found = (seen - distorted).length() <= 1e-12 * (1.0 + seen.length());
        if found { self.model.unproject(point) } else { None }
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
