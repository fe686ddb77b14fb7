use super::{Projection, sigmoid};
use crate::Profile;
use crate::naive::sh::{basis, basis_gradients};
use glam::{DMat2, DMat3, DVec2, DVec3};
use gs_scene::Camera;

/// Derivatives of a loss by the fields of [`Projected`](super::Projected).
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::naive) struct ProjectedGradients {
    pub(in crate::naive) mean: DVec2,
    pub(in crate::naive) conic: [f64; 3],
    pub(in crate::naive) depth: f64,
    pub(in crate::naive) rgb: [f64; 3],
    pub(in crate::naive) opacity: f64,
}

/// Derivatives of a loss by what is stored of one Gaussian, and its share of those by the pose.
pub(in crate::naive) struct StoredGradients {
    /// By mean, quaternion, log scale and logit, as in [`gs_scene::Gaussians`].
    pub(in crate::naive) geometry: [f64; 11],
    /// By the SH coefficients, `[K, 3]`.
    pub(in crate::naive) sh: Vec<f64>,
    /// By the world-to-camera rotation and translation.
    pub(in crate::naive) rotation: DMat3,
    pub(in crate::naive) translation: DVec3,
}

impl Projection {
    pub(in crate::naive) fn backward(
        &self,
        by: &ProjectedGradients,
        camera: &Camera,
        profile: &Profile,
    ) -> StoredGradients {
        let by_covariance = self.by_covariance(by, profile);
        // Σ₂ = V Vᵀ + ε I and V = J M, M = Rv R S.
        let [v0, v1] = self.v;
        let by_v = [
            2.0 * (by_covariance.x_axis.x * v0 + by_covariance.x_axis.y * v1),
            2.0 * (by_covariance.y_axis.x * v0 + by_covariance.y_axis.y * v1),
        ];
        let by_jacobian = by_v.map(|row| self.m * row);
        let by_m = outer(self.jacobian[0], by_v[0]) + outer(self.jacobian[1], by_v[1]);

        let scale = DMat3::from_diagonal(self.scale);
        let log_scale = [0, 1, 2].map(|k| self.m.col(k).dot(by_m.col(k)));
        let quaternion = self.by_quaternion(camera.rotation().transpose() * by_m * scale);

        let (by_sh, by_sight) = self.by_colour(by.rgb, profile);
        let by_p = self.by_centre(by, by_jacobian, camera);
        let mean = camera.rotation().transpose() * by_p + by_sight;

        let logit = by.opacity * self.compensation * sigmoid(self.logit) * sigmoid(-self.logit);
        let [w, x, y, z] = quaternion;
        let [s0, s1, s2] = log_scale;
        StoredGradients {
            geometry: [mean.x, mean.y, mean.z, w, x, y, z, s0, s1, s2, logit],
            sh: by_sh,
            // The line of sight is p - c = p + Rvᵀ t.
            rotation: outer(by_p, self.mean)
                + by_m * (self.rotation * scale).transpose()
                + outer(camera.translation(), by_sight),
            translation: by_p + camera.rotation() * by_sight,
        }
    }

    /// By Σ₂, as a symmetric matrix: through its inverse, and through the compensation of the opacity.
    fn by_covariance(&self, by: &ProjectedGradients, profile: &Profile) -> DMat2 {
        let symmetric = |a, b, c| DMat2::from_cols(DVec2::new(a, b), DVec2::new(b, c));
        let [a, b, c] = self.projected.conic;
        let inverse = symmetric(a, b, c);
        let [by_a, by_b, by_c] = by.conic;
        let by_covariance = -(inverse * symmetric(by_a, 0.5 * by_b, by_c) * inverse);

        let least = profile.compensation_min * profile.compensation_min;
        if !(profile.antialias && self.ratio > least) {
            return by_covariance;
        }
        // ratio = det₀ / det with det₀ = a₀ c₀ - b² and det = (a₀ + ε)(c₀ + ε) - b². The differences of its quotient
        // rule are written as sums of positive terms, such as c₀ det - (c₀ + ε) det₀ = ε (c₀² + ε c₀ + b²).
        let [v0, v1] = self.v;
        let (a, b, c) = (v0.dot(v0) / self.det, v0.dot(v1) / self.det, v1.dot(v1) / self.det);
        let eps = profile.eps2d / self.det;
        let by_ratio = by.opacity * sigmoid(self.logit) / (2.0 * self.compensation);
        by_covariance
            + by_ratio
                * profile.eps2d
                * symmetric(c * c + eps * c + b * b, -b * (a + c + eps), a * a + eps * a + b * b)
    }

    /// By the stored quaternion (w, x, y, z), from that by its matrix.
    fn by_quaternion(&self, by_rotation: DMat3) -> [f64; 4] {
        let [w, x, y, z] = self.unit;
        let g = |row: usize, column: usize| by_rotation.col(column)[row];
        let by_unit = [
            2.0 * (x * (g(2, 1) - g(1, 2)) + y * (g(0, 2) - g(2, 0)) + z * (g(1, 0) - g(0, 1))),
            2.0 * (y * (g(0, 1) + g(1, 0)) + z * (g(0, 2) + g(2, 0)) + w * (g(2, 1) - g(1, 2)))
                - 4.0 * x * (g(1, 1) + g(2, 2)),
            2.0 * (x * (g(0, 1) + g(1, 0)) + z * (g(1, 2) + g(2, 1)) + w * (g(0, 2) - g(2, 0)))
                - 4.0 * y * (g(0, 0) + g(2, 2)),
            2.0 * (x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) + w * (g(1, 0) - g(0, 1)))
                - 4.0 * z * (g(0, 0) + g(1, 1)),
        ];
        let along: f64 = self.unit.iter().zip(by_unit).map(|(q, g)| q * g).sum();
        [0, 1, 2, 3].map(|i| (by_unit[i] - self.unit[i] * along) / self.norm)
    }

    /// By the SH coefficients, and by the line of sight. A channel that the clamp holds at 0 takes no part.
    fn by_colour(&self, by_rgb: [f64; 3], profile: &Profile) -> (Vec<f64>, DVec3) {
        let by_channels = [0, 1, 2].map(|c| if self.channels[c] >= 0.0 { by_rgb[c] } else { 0.0 });
        let in_axes = profile.sh_axes.coordinates(self.direction);
        let (mut by_sh, mut by_axes) = (Vec::with_capacity(self.sh.len()), DVec3::ZERO);
        let basis = basis(in_axes).into_iter().zip(basis_gradients(in_axes));
        for ((y, by_direction), coefficients) in basis.zip(self.sh.chunks_exact(3)) {
            by_sh.extend(by_channels.map(|by| y * by));
            let by_basis: f64 = coefficients.iter().zip(by_channels).map(|(sh, by)| sh * by).sum();
            by_axes += by_basis * by_direction;
        }
        let by_direction = profile.sh_axes.to_world(by_axes);
        let across = by_direction - self.direction * self.direction.dot(by_direction);
        (by_sh, across / self.distance)
    }

    /// By the centre in camera axes: through the pixel, the depth and the Jacobian.
    fn by_centre(&self, by: &ProjectedGradients, by_jacobian: [DVec3; 2], camera: &Camera) -> DVec3 {
        let lens = camera.intrinsics();
        let z = self.p.z;
        let mut by_z = by.depth;
        let mut axis = |i: usize, focal: f64| {
            let (u, row) = (self.p[i], by_jacobian[i]);
            // Mean f u/z; Jacobian f/z and -f slope/z, where slope is u/z unless it is clamped.
            let by_slope = if self.inside[i] { -focal / z * row.z } else { 0.0 };
            by_z += -by.mean[i] * focal * u / (z * z) - row[i] * focal / (z * z)
                + row.z * focal * self.slope[i] / (z * z)
                - by_slope * u / (z * z);
            by.mean[i] * focal / z + by_slope / z
        };
        let (by_x, by_y) = (axis(0, lens.fx), axis(1, lens.fy));
        DVec3::new(by_x, by_y, by_z)
    }
}

/// a bᵀ.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
