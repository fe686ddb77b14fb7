//! The projection of a Gaussian (EWA, Zwicker et al. 2001), shared by the passes `project` and `project_backward`.

use crate::frame::join;
use glam::{DMat3, DVec2, DVec3};
use gs_shaders::{Features, Frame, GEOMETRY, SIGMA_MAX};

/// A Gaussian with its parameters activated.
pub(crate) struct Activated {
    pub(crate) mean: DVec3,
    /// Unit quaternion (w, x, y, z), and the norm of the stored one.
    pub(crate) quaternion: [f64; 4],
    pub(crate) norm: f64,
    /// Columns are the local axes in the world.
    pub(crate) axes: DMat3,
    /// Standard deviations, scene units.
    pub(crate) scale: DVec3,
    pub(crate) logit: f64,
    /// Whether the quaternion is not zero and the scales do not overflow f32.
    pub(crate) valid: bool,
}

/// A position as the camera sees it.
pub(crate) struct Seen {
    /// Camera axes, scene units.
    pub(crate) p: DVec3,
    /// x/z and y/z, and the same clamped to where the projection is linearised.
    pub(crate) slope: DVec2,
    pub(crate) clamped: DVec2,
}

/// A footprint, and what its derivatives need.
pub(crate) struct Footprint {
    pub(crate) mean: DVec2,
    pub(crate) falloff: DVec2,
    pub(crate) shear: f64,
    /// After compensation.
    pub(crate) opacity: f64,
    /// Rows of the Jacobian of the projection times the camera's rotation, 1 pixel / scene unit.
    pub(crate) jacobian_u: DVec3,
    pub(crate) jacobian_v: DVec3,
    /// Standard deviations after the limit of `SIGMA_MAX`.
    pub(crate) scale: DVec3,
    /// Rows of V in the covariance V Vᵀ + eps2d I, pixels.
    pub(crate) u: DVec3,
    pub(crate) v: DVec3,
    /// Determinants of V Vᵀ and of the covariance.
    pub(crate) det_sharp: f64,
    pub(crate) det: f64,
}

pub(crate) fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from(v.map(f64::from))
}

/// A row of the camera's rotation.
pub(crate) fn rotation_row(frame: &Frame, row: usize) -> DVec3 {
    let [x, y, z, _] = join(frame.pose[row], frame.pose_low[row]);
    DVec3::new(x, y, z)
}

/// Focal lengths, pixels.
pub(crate) fn focal_of(frame: &Frame) -> DVec2 {
    DVec2::from(join(frame.focal, frame.focal_low))
}

/// From the camera to a position.
pub(crate) fn from_camera(frame: &Frame, mean: DVec3) -> DVec3 {
    mean - DVec3::from(join(frame.position, frame.position_low))
}

pub(crate) fn activated(geometry: &[f32], index: usize) -> Activated {
    let row: Vec<f64> = geometry[index * GEOMETRY..][..GEOMETRY].iter().map(|&v| f64::from(v)).collect();
    let norm = row[3..7].iter().map(|q| q * q).sum::<f64>().sqrt();
    let quaternion = [row[3] / norm, row[4] / norm, row[5] / norm, row[6] / norm];
    let [w, x, y, z] = quaternion;
    let axes = DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
    let scale = DVec3::new(row[7].exp(), row[8].exp(), row[9].exp());
    Activated {
        mean: DVec3::new(row[0], row[1], row[2]),
        quaternion,
        norm,
        axes,
        scale,
        logit: row[10],
        valid: norm > 0.0 && (scale.max_element() as f32).is_finite(),
    }
}

pub(crate) fn seen_at(frame: &Frame, mean: DVec3) -> Seen {
    let translation = [0, 1, 2].map(|row| join(frame.pose[row], frame.pose_low[row])[3]);
    let p = DVec3::from([0, 1, 2].map(|row| rotation_row(frame, row).dot(mean) + translation[row]));
    let slope = p.truncate() / p.z;
    let [least, largest] = [frame.slope_min, frame.slope_max].map(|slope| DVec2::from(slope.map(f64::from)));
    // Not clamp(), which refuses NaN: what is not finite is rejected later.
    let clamped = slope.max(least).min(largest);
    Seen { p, slope, clamped }
}

pub(crate) fn footprint_of(
    frame: &Frame,
    gaussian: &Activated,
    seen: &Seen,
    features: Features,
) -> Footprint {
    let focal = focal_of(frame);
    let eps2d = f64::from(frame.eps2d);
    let forward = rotation_row(frame, 2);
    let jacobian_u = (rotation_row(frame, 0) - forward * seen.clamped.x) * (focal.x / seen.p.z);
    let jacobian_v = (rotation_row(frame, 1) - forward * seen.clamped.y) * (focal.y / seen.p.z);
    let longest = f64::from(SIGMA_MAX) * seen.p.z / focal.max_element();
    let scale = gaussian.scale.min(DVec3::splat(longest));
    let u = gaussian.axes.transpose() * jacobian_u * scale;
    let v = gaussian.axes.transpose() * jacobian_v * scale;
    // The determinant as a sum of positive terms (Cauchy-Binet): a c - b² would cancel for needles.
    let (a, b, c) = (u.dot(u), u.dot(v), v.dot(v));
    let det_sharp = u.cross(v).length_squared();
    let det = det_sharp + eps2d * (a + c) + eps2d * eps2d;
    let filtered_c = c + eps2d;
    let compensation = (det_sharp / det).sqrt().max(f64::from(frame.compensation_min));
    Footprint {
        mean: focal * seen.slope + DVec2::from(join(frame.centre, frame.centre_low)),
        falloff: -0.5 * std::f64::consts::LOG2_E * DVec2::new(filtered_c / det, 1.0 / filtered_c),
        shear: b / filtered_c,
        opacity: sigmoid(gaussian.logit) * if features.antialias { compensation } else { 1.0 },
        jacobian_u,
        jacobian_v,
        scale,
        u,
        v,
        det_sharp,
        det,
    }
}

/// The logistic function.
pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
