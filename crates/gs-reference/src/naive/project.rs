//! EWA splatting (Zwicker et al. 2001) of one Gaussian, and its derivatives.

mod backward;

pub(super) use backward::ProjectedGradients;

use super::sh::basis;
use crate::Profile;
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Gaussians, sh_coefficients};

/// One Gaussian between near and far, as a camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected {
    /// Index in the scene.
    pub index: usize,
    /// Centre, pixels.
    pub mean: DVec2,
    /// (A, B, C) of the inverse 2D covariance [A B; B C], 1 / square pixels.
    pub conic: [f64; 3],
    /// z-depth of the centre, scene units.
    pub depth: f64,
    /// Colour, not negative.
    pub rgb: [f64; 3],
    /// Opacity, compensated if the profile says so.
    pub opacity: f64,
}

/// Gaussian `index` of a scene as a camera sees it: EWA splatting (Zwicker et al. 2001) with the Jacobian evaluated
/// at a direction clamped to the image and 15 % of its size around it. `None` if it is not between near and far, if a
/// stored value is not finite, if its quaternion is zero, if it is at the camera's centre, or if a scale or the footprint
/// overflows.
#[must_use]
pub fn project(gaussians: &Gaussians, index: usize, camera: &Camera, profile: &Profile) -> Option<Projected> {
    Projection::new(gaussians, index, camera, profile).map(|projection| projection.projected)
}

/// A projected Gaussian with all that its derivatives need.
pub(super) struct Projection {
    pub(super) projected: Projected,
    /// Centre in the world and in camera axes, scene units.
    mean: DVec3,
    pub(super) p: DVec3,
    /// Norm of the stored quaternion, and the quaternion (w, x, y, z) divided by it.
    norm: f64,
    unit: [f64; 4],
    /// Its matrix and the standard deviations: local axes to the world.
    rotation: DMat3,
    scale: DVec3,
    /// (x/z, y/z) clamped, and whether each was not.
    slope: DVec2,
    inside: [bool; 2],
    /// Rows of the Jacobian of the pinhole projection.
    jacobian: [DVec3; 2],
    /// Rv R S, and the rows of V = J Rv R S.
    pub(super) m: DMat3,
    pub(super) v: [DVec3; 2],
    /// det(V Vᵀ + ε I); det(V Vᵀ) divided by it, and the factor on the opacity that follows.
    det: f64,
    ratio: f64,
    compensation: f64,
    logit: f64,
    /// From the camera's centre to the Gaussian's: length, scene units, and direction.
    distance: f64,
    direction: DVec3,
    /// SH coefficients [K, 3], and the channels before the clamp.
    sh: Vec<f64>,
    channels: [f64; 3],
}

impl Projection {
    pub(super) fn new(
        gaussians: &Gaussians,
        index: usize,
        camera: &Camera,
        profile: &Profile,
    ) -> Option<Self> {
        let row: Vec<f64> = gaussians.geometry()[index * 11..][..11].iter().map(|&v| f64::from(v)).collect();
        let k = sh_coefficients(gaussians.sh_degree());
        let sh: Vec<f64> = gaussians.sh()[index * k * 3..][..k * 3].iter().map(|&v| f64::from(v)).collect();
        if !row.iter().chain(&sh).all(|value| value.is_finite()) {
            return None;
        }
        let mean = DVec3::new(row[0], row[1], row[2]);
        let p = camera.rotation() * mean + camera.translation();
        if !(p.z > profile.near && p.z < profile.far) {
            return None;
        }

        let norm = (row[3] * row[3] + row[4] * row[4] + row[5] * row[5] + row[6] * row[6]).sqrt();
        if norm == 0.0 {
            return None;
        }
        let unit = [row[3] / norm, row[4] / norm, row[5] / norm, row[6] / norm];
        let [w, x, y, z] = unit;
        let rotation = DMat3::from_cols(
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
            DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
            DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
        );
        let scale = DVec3::new(row[7].exp(), row[8].exp(), row[9].exp());
        if scale.max_element() > f64::from(f32::MAX) {
            return None;
        }

        let lens = camera.intrinsics();
        let (width, height) = (lens.width as f64, lens.height as f64);
        let clamp = |slope: f64, centre: f64, size: f64, focal: f64| {
            let margin = 0.3 * size / (2.0 * focal);
            slope.max(-(centre / focal + margin)).min((size - centre) / focal + margin)
        };
        let ux = clamp(p.x / p.z, lens.cx, width, lens.fx);
        let uy = clamp(p.y / p.z, lens.cy, height, lens.fy);
        let jacobian = [
            DVec3::new(lens.fx / p.z, 0.0, -lens.fx * ux / p.z),
            DVec3::new(0.0, lens.fy / p.z, -lens.fy * uy / p.z),
        ];
        let m = camera.rotation() * rotation * DMat3::from_diagonal(scale);
        let v = jacobian.map(|row| m.transpose() * row);

        // Covariance V Vᵀ + ε I. Its determinant by Cauchy-Binet: a c - b² would cancel for needles, in f64 too.
        let (a0, b, c0) = (v[0].dot(v[0]), v[0].dot(v[1]), v[1].dot(v[1]));
        let det0 = v[0].cross(v[1]).length_squared();
        let det = det0 + profile.eps2d * (a0 + c0) + profile.eps2d * profile.eps2d;
        let conic = [(c0 + profile.eps2d) / det, -b / det, (a0 + profile.eps2d) / det];

        let ratio = det0 / det;
        let least = profile.compensation_min * profile.compensation_min;
        let compensation = if profile.antialias { ratio.max(least).sqrt() } else { 1.0 };

        let sight = mean - camera.position();
        let distance = sight.length();
        let direction = sight / distance;
        let y = basis(profile.sh_axes.coordinates(direction));
        let channels = [0, 1, 2].map(|c| 0.5 + (0..k).map(|i| y[i] * sh[i * 3 + c]).sum::<f64>());
        let projected = Projected {
            index,
            mean: DVec2::new(lens.fx * p.x / p.z + lens.cx, lens.fy * p.y / p.z + lens.cy),
            conic,
            depth: p.z,
            rgb: channels.map(|channel| channel.max(0.0)),
            opacity: sigmoid(row[10]) * compensation,
        };
        let numbers = [projected.mean.x, projected.mean.y, direction.x, direction.y, direction.z];
        numbers.iter().chain(&projected.conic).chain(&channels).all(|number| number.is_finite()).then_some(
            Self {
                projected,
                mean,
                p,
                norm,
                unit,
                rotation,
                scale,
                slope: DVec2::new(ux, uy),
                inside: [ux == p.x / p.z, uy == p.y / p.z],
                jacobian,
                m,
                v,
                det,
                ratio,
                compensation,
                logit: row[10],
                distance,
                direction,
                sh,
                channels,
            },
        )
    }
}

/// The logistic function; no cancellation for arguments of either sign.
fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
