//! Gaussians to footprints: culling, EWA projection of the covariance (Zwicker et al. 2001), bounds, colour.
//!
//! Geometry is computed in f64 and rounded once: scenes far from the origin, needles and huge scales keep their
//! precision.

use super::sh;
use crate::RenderSettings;
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sh_coefficients};
use rayon::prelude::*;
use std::f64::consts::{LN_2, LOG2_E};

/// Gaussians per task; fixed, so that the result does not depend on the number of threads.
const CHUNK: usize = 4096;
/// Least opacity compensation of [`RenderSettings::antialias`], so that tiny Gaussians do not vanish.
const COMPENSATION_MIN: f64 = 0.005;
/// Added to the squared Mahalanobis distance that bounds a footprint: far above the rounding of the blending stage,
/// which takes the decision itself, and too small to cost anything.
const BOUND_SLACK: f64 = 1e-3;
/// Longest standard deviation of a footprint, pixels. Longer axes are shortened, not thickened: over an image, no
/// falloff changes by more than rounding, and the footprint's numbers and their squares fit f32. What is centred so much
/// farther outside than this is not drawn.
const SIGMA_MAX: f64 = 1e12;

/// The footprint of one Gaussian in the image: 64 bytes, one cache line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Splat {
    /// Centre, pixels.
    pub(super) mean: [f64; 2],
    /// (p, r): in a pixel at (dx, dy) from the centre, log₂ of the falloff is p (dx - shear dy)² + r dy². This form of
    /// the quadratic adds terms of one sign, where p dx² + q dx dy + r dy² would cancel for needles.
    pub(super) falloff: [f32; 2],
    /// log₂ of the opacity.
    pub(super) log2_opacity: f32,
    /// Colour.
    pub(super) rgb: [f32; 3],
    /// z-depth of the centre, scene units.
    pub(super) depth: f32,
    /// Half width and half height of the ellipse outside which alpha is below `alpha_min`, pixels.
    pub(super) extent: [f32; 2],
    /// dx of the middle of the ellipse's row at dy = 1 (its centre's is at 0).
    pub(super) shear: f32,
    /// Half width of the ellipse's row at dy = 0, pixels.
    pub(super) half_width: f32,
}

/// What is left of a scene in one view.
pub(super) struct Projection {
    /// Visible Gaussians, in the order of the scene.
    pub(super) splats: Vec<Splat>,
    /// See [`RenderStats::rejected`](crate::RenderStats::rejected).
    pub(super) rejected: usize,
}

/// Projects every Gaussian of a scene.
pub(super) fn project(gaussians: &Gaussians, camera: &Camera, settings: &RenderSettings) -> Projection {
    match gaussians.sh_degree() {
        0 => project_degree::<0>(gaussians, camera, settings),
        1 => project_degree::<1>(gaussians, camera, settings),
        2 => project_degree::<2>(gaussians, camera, settings),
        _ => project_degree::<3>(gaussians, camera, settings),
    }
}

fn project_degree<const DEGREE: usize>(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
) -> Projection {
    let projector = Projector::new(camera, settings);
    let sh_row = sh_coefficients(DEGREE) * 3;
    let chunks: Vec<Projection> = gaussians
        .geometry()
        .par_chunks(CHUNK * Gaussians::GEOMETRY)
        .zip(gaussians.sh().par_chunks(CHUNK * sh_row))
        .map(|(geometry, sh)| {
            let mut chunk = Projection { splats: Vec::with_capacity(CHUNK), rejected: 0 };
            for (row, sh) in geometry.chunks_exact(Gaussians::GEOMETRY).zip(sh.chunks_exact(sh_row)) {
                match projector.splat::<DEGREE>(row, sh) {
                    Outcome::Visible(splat) => chunk.splats.push(splat),
                    Outcome::Culled => {}
                    Outcome::Rejected => chunk.rejected += 1,
                }
            }
            chunk
        })
        .collect();
    let rejected = chunks.iter().map(|chunk| chunk.rejected).sum();
    let mut splats = Vec::with_capacity(chunks.iter().map(|chunk| chunk.splats.len()).sum());
    for chunk in chunks {
        splats.extend_from_slice(&chunk.splats);
    }
    Projection { splats, rejected }
}

enum Outcome {
    Visible(Splat),
    Culled,
    Rejected,
}

/// What is the same for all Gaussians of a view.
struct Projector<'a> {
    settings: &'a RenderSettings,
    rotation: DMat3,
    translation: DVec3,
    position: DVec3,
    focal: [f64; 2],
    centre: [f64; 2],
    size: [f64; 2],
    /// Least and largest x/z and y/z at which the Jacobian is evaluated: the image and 15 % of its size around it.
    slope_min: [f64; 2],
    slope_max: [f64; 2],
    /// Squared Mahalanobis distance that bounds the footprint of an opaque Gaussian.
    bound_max: f64,
    /// Standard deviation of the low-pass filter, pixels.
    sigma_min: f64,
}

impl<'a> Projector<'a> {
    fn new(camera: &Camera, settings: &'a RenderSettings) -> Self {
        let lens = camera.intrinsics();
        let (focal, centre) = ([lens.fx, lens.fy], [lens.cx, lens.cy]);
        let size = [lens.width as f64, lens.height as f64];
        let margin = |axis: usize| 0.15 * size[axis] / focal[axis];
        Self {
            settings,
            rotation: camera.rotation(),
            translation: camera.translation(),
            position: camera.position(),
            focal,
            centre,
            size,
            slope_min: [0, 1].map(|axis| -centre[axis] / focal[axis] - margin(axis)),
            slope_max: [0, 1].map(|axis| (size[axis] - centre[axis]) / focal[axis] + margin(axis)),
            bound_max: -2.0 * f64::from(settings.alpha_min).ln() + BOUND_SLACK,
            sigma_min: f64::from(settings.eps2d).sqrt(),
        }
    }

    /// One Gaussian. Every test is written so that NaN fails it.
    fn splat<const DEGREE: usize>(&self, row: &[f32], sh: &[f32]) -> Outcome {
        let settings = self.settings;
        if !row.iter().all(|value| value.is_finite()) {
            return Outcome::Rejected;
        }
        let vector = |columns: std::ops::Range<usize>| {
            DVec3::new(
                f64::from(row[columns.start]),
                f64::from(row[columns.start + 1]),
                f64::from(row[columns.start + 2]),
            )
        };
        let mean = vector(MEAN);
        let p = self.rotation * mean + self.translation;
        if !(p.z > f64::from(settings.near) && p.z < f64::from(settings.far)) {
            return Outcome::Culled;
        }

        let inverse_z = p.z.recip();
        let slope = [p.x * inverse_z, p.y * inverse_z];
        let centre = [self.focal[0] * slope[0] + self.centre[0], self.focal[1] * slope[1] + self.centre[1]];
        let clamp = |i: usize| slope[i].clamp(self.slope_min[i], self.slope_max[i]);
        let clamped = [clamp(0), clamp(1)];
        let outside =
            |i: usize, extent: f64| centre[i] + extent < 0.5 || centre[i] - extent > self.size[i] - 0.5;
        // Most Gaussians outside the image are far outside: an opaque ball around such a one misses it, too. The ball
        // is a little larger because a valid rotation may be off by 1e-4.
        let radius = 1.001 * vector(LOG_SCALE).max_element().exp();
        let reach = |i: usize| {
            let jacobian = self.focal[i] * inverse_z * (1.0 + clamped[i] * clamped[i]).sqrt();
            self.bound_max.sqrt() * (jacobian * radius + self.sigma_min)
        };
        if outside(0, reach(0)) || outside(1, reach(1)) {
            return Outcome::Culled;
        }

        let q = QUATERNION.start;
        let quaternion = DQuat::from_xyzw(
            f64::from(row[q + 1]),
            f64::from(row[q + 2]),
            f64::from(row[q + 3]),
            f64::from(row[q]),
        );
        let norm = quaternion.length();
        if norm == 0.0 {
            return Outcome::Rejected;
        }
        let axes = DMat3::from_quat(quaternion * norm.recip());
        let scale = vector(LOG_SCALE).exp();
        if scale.max_element() > f64::from(f32::MAX) {
            return Outcome::Rejected;
        }
        let scale = scale.min(DVec3::splat(SIGMA_MAX * p.z / self.focal[0].max(self.focal[1])));

        // Rows of V = J · Rv · R · S, J evaluated at the clamped direction.
        let rotation_rows = [self.rotation.row(0), self.rotation.row(1)];
        let forward = self.rotation.row(2);
        let row_of_v = |i: usize| {
            let jacobian = (rotation_rows[i] - forward * clamped[i]) * (self.focal[i] * inverse_z);
            axes.transpose() * jacobian * scale
        };
        let (u, v) = (row_of_v(0), row_of_v(1));
        // The 2D covariance [a b; b c]; its determinant as a sum of positive terms (Cauchy–Binet), because
        // a c - b² cancels for needles.
        let eps = f64::from(settings.eps2d);
        let (a0, b, c0) = (u.length_squared(), u.dot(v), v.length_squared());
        let det0 = u.cross(v).length_squared();
        let det = det0 + eps * (a0 + c0) + eps * eps;
        let (a, c) = (a0 + eps, c0 + eps);

        let mut opacity = 1.0 / (1.0 + (-f64::from(row[OPACITY_LOGIT])).exp());
        if settings.antialias {
            opacity *= (det0 / det).sqrt().max(COMPENSATION_MIN);
        }
        let alpha_min = f64::from(settings.alpha_min);
        if opacity < alpha_min {
            return Outcome::Culled;
        }

        // alpha ≥ alpha_min where the squared Mahalanobis distance is at most `bound`.
        let log2_opacity = opacity.log2();
        let bound = 2.0 * LN_2 * log2_opacity + self.bound_max;
        let extent = [(bound * a).sqrt(), (bound * c).sqrt()];
        let inverse_c = c.recip();
        let half_width = (bound * det * inverse_c).sqrt();
        // The conic [A B; B C] in the form A (dx - shear dy)² + dy² / c, with A = c / det and shear = -B / A = b / c.
        let falloff = [-0.5 * LOG2_E * c / det, -0.5 * LOG2_E * inverse_c];
        let shear = b * inverse_c;
        let numbers = [extent[0], extent[1], half_width, centre[0], centre[1], falloff[0], falloff[1], shear];
        if !numbers.iter().all(|value| value.is_finite()) {
            return Outcome::Rejected;
        }
        if outside(0, extent[0]) || outside(1, extent[1]) {
            return Outcome::Culled;
        }

        let direction = (mean - self.position).normalize().as_vec3().to_array();
        let rgb = sh::colour::<DEGREE>(direction, sh);
        if !rgb.iter().all(|channel| channel.is_finite()) {
            return Outcome::Rejected;
        }
        Outcome::Visible(Splat {
            mean: centre,
            falloff: [falloff[0] as f32, falloff[1] as f32],
            log2_opacity: log2_opacity as f32,
            rgb: rgb.map(|channel| channel.max(0.0)),
            depth: p.z as f32,
            extent: [extent[0] as f32, extent[1] as f32],
            shear: shear as f32,
            half_width: half_width as f32,
        })
    }
}
