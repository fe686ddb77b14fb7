//! A cluster of merged Gaussians: its moments, and the error of a further merge.

use super::covariance::{axes, covariance};
use glam::{DMat3, DVec3};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, rgb_from_dc};

/// Colour difference (Euclidean, RGB 0..1) that weighs as much as the distance of one patch width; as for the cells.
pub const COLOUR_SCALE: f32 = 0.12;
/// Largest opacity: renderers draw none above it.
const LARGEST_OPACITY: f64 = 0.99;
/// Smallest opacity, of what is merged across all depths: its logit stays of use.
const SMALLEST_OPACITY: f64 = 1e-6;
/// Variance of a Gaussian over that of what was merged into it. Blending lets more through between Gaussians than the
/// sum that moments keep: at 40k, 1 loses 1.1 dB and 2.6 loses 0.2.
pub(super) const SPREAD: f64 = 1.7;
/// Smallest ratio of two standard deviations.
const SMALLEST_ASPECT: f64 = 1e-4;

/// Gaussians that have become one: their moments, weighted by optical mass, -ln(1 - opacity) times the area of the disc.
#[derive(Debug, Clone, Copy)]
pub struct Cluster {
    /// Optical mass, scene units².
    pub mass: f64,
    /// The same in pixels where it is: what it weighs in a picture.
    pub(super) weight: f64,
    /// Mean by mass, world axes, scene units.
    pub mean: DVec3,
    /// Second central moments by mass, scene units².
    pub covariance: DMat3,
    /// How many they are.
    pub(super) members: u32,
}

/// Colour of SH coefficients that begin with the constant one.
pub(super) fn colour(sh: &[f32]) -> [f32; 3] {
    rgb_from_dc([sh[0], sh[1], sh[2]])
}

/// What the picture loses, squared and summed over pixels, up to a common factor, if two become one.
pub(super) fn cost(a: (&Cluster, [f32; 3]), b: (&Cluster, [f32; 3]), patch: f64) -> f32 {
    let ((a, a_colour), (b, b_colour)) = (a, b);
    let weight = a.weight + b.weight;
    let pixel = (a.mass + b.mass) / weight;
    let distance = a.mean.distance_squared(b.mean) / (pixel * patch);
    let colour: f32 = (0..3).map(|c| (a_colour[c] - b_colour[c]).powi(2)).sum();
    let colour = f64::from(colour / (COLOUR_SCALE * COLOUR_SCALE));
    let cost = (a.weight * b.weight / weight * (distance + colour)) as f32;
    if cost.is_finite() { cost } else { f32::MAX }
}

impl Cluster {
    /// One Gaussian, the row of its geometry, which stands for a patch whose pixels are `width` wide, scene units.
    #[must_use]
    pub fn new(row: &[f32], width: f32) -> Self {
        let [first, second, third] = [0, 1, 2].map(|i| f64::from(row[LOG_SCALE.start + i]));
        let thinnest = first.min(second).min(third);
        let mass = (optical_depth(row[OPACITY_LOGIT]).ln() + first + second + third - thinnest).exp();
        Self {
            mass,
            weight: mass / f64::from(width).powi(2),
            mean: DVec3::from_array([0, 1, 2].map(|i| f64::from(row[MEAN.start + i]))),
            covariance: covariance(&row[QUATERNION], &row[LOG_SCALE]),
            members: 1,
        }
    }

    /// Both as one, with their moments.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let (p, q) = (self.mass / mass, other.mass / mass);
        let step = other.mean - self.mean;
        let between = DMat3::from_cols(step * step.x, step * step.y, step * step.z) * (p * q);
        Self {
            mass,
            weight: self.weight + other.weight,
            mean: self.mean * p + other.mean * q,
            covariance: self.covariance * p + other.covariance * q + between,
            members: self.members + other.members,
        }
    }

    /// Appends it as a Gaussian with this SH; `row` is the Gaussian that it was to begin with, and still is if nothing
    /// was merged into it.
    pub(super) fn push(&self, row: &[f32], sh: &[f32], gaussians: &mut Gaussians) {
        if self.members == 1 {
            let [mean, scale] = [&row[MEAN], &row[LOG_SCALE]].map(|part| [part[0], part[1], part[2]]);
            let q = &row[QUATERNION];
            return gaussians.push(mean, [q[0], q[1], q[2], q[3]], scale, row[OPACITY_LOGIT], sh);
        }
        let row = self.row(SPREAD);
        let [mean, scale] = [&row[MEAN], &row[LOG_SCALE]].map(|part| [part[0], part[1], part[2]]);
        let q = &row[QUATERNION];
        gaussians.push(mean, [q[0], q[1], q[2], q[3]], scale, row[OPACITY_LOGIT], sh);
    }

    /// The Gaussian with these moments, as the row of its geometry, its variances times `spread`.
    #[must_use]
    pub fn row(&self, spread: f64) -> [f32; Gaussians::GEOMETRY] {
        let (rotation, variances) = axes(self.covariance);
        let wide = variances[0].sqrt().max(f64::from(f32::MIN_POSITIVE));
        let deviations = variances.map(|v| v.sqrt().max(SMALLEST_ASPECT * wide));
        let depth = self.mass / (deviations[0] * deviations[1]);
        let opacity = (-(-depth).exp_m1()).clamp(SMALLEST_OPACITY, LARGEST_OPACITY);
        let mut row = [0.0; Gaussians::GEOMETRY];
        row[MEAN].copy_from_slice(&self.mean.as_vec3().to_array());
        row[QUATERNION].copy_from_slice(&[rotation.w, rotation.x, rotation.y, rotation.z].map(|v| v as f32));
        row[LOG_SCALE]
            .copy_from_slice(&deviations.map(|s| ((spread.sqrt() * s) as f32).max(f32::MIN_POSITIVE).ln()));
        row[OPACITY_LOGIT] = (opacity / (1.0 - opacity)).ln() as f32;
        row
    }
}

/// -ln(1 - opacity) of an opacity's logit.
fn optical_depth(logit: f32) -> f64 {
    let logit = f64::from(logit);
    // ln(1 + e^x), stable for large x; what is fainter than 1e-12 is not told apart.
    (logit.max(0.0) + (-logit.abs()).exp().ln_1p()).max(1e-12)
}
