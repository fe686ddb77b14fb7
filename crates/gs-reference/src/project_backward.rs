//! Twin of the pass `project_backward`: derivatives by what is stored of the Gaussians, and by the pose.

use crate::ewa::{Footprint, activated, focal_of, footprint_of, from_camera, rotation_row, seen_at, sigmoid};
use crate::frame::outer;
use crate::sh::{sh_at, sh_basis, sh_coefficients, sh_gradient};
use glam::{DMat2, DMat3, DVec2, DVec3};
use gs_shaders::{Features, Frame, GEOMETRY, PAIR_GRADS, POSE_SUMS, WORKGROUP};

/// What the pass adds for N Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredGradients {
    /// By the geometry buffer, `[N, 11]`.
    pub geometry: Vec<f32>,
    /// By the SH coefficients, `[N, (SH_DEGREE + 1)², 3]`.
    pub sh: Vec<f32>,
    /// `[workgroups, 15]` by a turn and stretch D of the camera's axes, p ← D p (9), by t (3), and by the camera centre
    /// through colours (3).
    pub pose_sums: Vec<f32>,
}

/// Derivatives by what is stored, from those by the footprints: `order` are the indices of the Gaussians near to far,
/// `offsets` `[N + 1]` the place of the first pair of each in that order, `pair_grads` `[pairs, 10]` as `rasterize_backward`
/// writes them.
#[must_use]
pub fn project_backward(
    frame: &Frame,
    geometry: &[f32],
    sh: &[f32],
    order: &[u32],
    offsets: &[u32],
    pair_grads: &[f32],
    features: Features,
) -> StoredGradients {
    let n = frame.n_gaussians as usize;
    let k = sh_coefficients(features);
    let mut out = StoredGradients {
        geometry: vec![0.0; n * GEOMETRY],
        sh: vec![0.0; n * k * 3],
        pose_sums: Vec::new(),
    };
    for group in 0..n.div_ceil(WORKGROUP as usize) {
        let first = group * WORKGROUP as usize;
        let mut pose_sums = [0.0; POSE_SUMS];
        for rank in first..n.min(first + WORKGROUP as usize) {
            let (from, to) = (offsets[rank] as usize, offsets[rank + 1] as usize);
            if from == to {
                continue;
            }
            let mut sums = [0.0; PAIR_GRADS];
            for pair in pair_grads[from * PAIR_GRADS..to * PAIR_GRADS].chunks_exact(PAIR_GRADS) {
                for (sum, &value) in sums.iter_mut().zip(pair) {
                    *sum += f64::from(value);
                }
            }
            let index = order[rank] as usize;
            let by = differentiate(frame, geometry, sh, index, &sums, features);
            for (grad, by) in out.geometry[index * GEOMETRY..].iter_mut().zip(by.geometry) {
                *grad = defined(by);
            }
            for (grad, by) in out.sh[index * k * 3..].iter_mut().zip(by.sh) {
                *grad = defined(by);
            }
            for (sum, by) in pose_sums.iter_mut().zip(by.pose) {
                *sum += f64::from(defined(by));
            }
        }
        out.pose_sums.extend(pose_sums.map(|sum| sum as f32));
    }
    out
}

/// What one Gaussian contributes.
struct Contribution {
    geometry: [f64; GEOMETRY],
    sh: Vec<f64>,
    pose: [f64; POSE_SUMS],
}

fn differentiate(
    frame: &Frame,
    geometry: &[f32],
    sh: &[f32],
    index: usize,
    sums: &[f64; PAIR_GRADS],
    features: Features,
) -> Contribution {
    let gaussian = activated(geometry, index);
    let seen = seen_at(frame, gaussian.mean);
    let f = footprint_of(frame, &gaussian, &seen, features);
    let z = seen.p.z;
    let focal = focal_of(frame);

    // The exponent is dᵀ Q d / 2 with Q = Hᵀ diag(a, g) H, where H d = (e, dy).
    let [a, g] = [f.falloff.x, f.falloff.y].map(|falloff| -2.0 * std::f64::consts::LN_2 * falloff);
    let h = DMat2::from_cols(DVec2::X, DVec2::new(-f.shear, 1.0));
    let to_gradient = h.transpose() * DMat2::from_diagonal(DVec2::new(a, g));
    let grad_mean = -(to_gradient * DVec2::new(sums[1], sums[2]));
    // By the covariance: -½ (Q d)(Q d)ᵀ.
    let second = DMat2::from_cols(DVec2::new(sums[3], sums[4]), DVec2::new(sums[4], sums[5]));
    let grad_covariance = -0.5 * (to_gradient * second * to_gradient.transpose());
    let mut grad_u = 2.0 * (grad_covariance.x_axis.x * f.u + grad_covariance.x_axis.y * f.v);
    let mut grad_v = 2.0 * (grad_covariance.y_axis.x * f.u + grad_covariance.y_axis.y * f.v);
    let grad_ln_opacity = -sums[0];
    if features.antialias && (f.det_sharp / f.det).sqrt() > f64::from(frame.compensation_min) {
        let [by_u, by_v] = ln_compensation_gradient(frame, &f);
        grad_u += grad_ln_opacity * by_u;
        grad_v += grad_ln_opacity * by_v;
    }

    // u and v are (axesᵀ jacobian) scale.
    let limited = gaussian.scale.cmpgt(f.scale);
    let grad_log_scale = DVec3::select(limited, DVec3::ZERO, grad_u * f.u + grad_v * f.v);
    let (scaled_u, scaled_v) = (grad_u * f.scale, grad_v * f.scale);
    let (grad_jacobian_u, grad_jacobian_v) = (gaussian.axes * scaled_u, gaussian.axes * scaled_v);
    let grad_axes = outer(f.jacobian_u, scaled_u) + outer(f.jacobian_v, scaled_v);
    let grad_quaternion = quaternion_gradient(gaussian.quaternion, grad_axes).map(|by| by / gaussian.norm);

    // jacobian = (row of R - slope · forward) focal / z.
    let forward = rotation_row(frame, 2);
    let by_row = [grad_jacobian_u * (focal.x / z), grad_jacobian_v * (focal.y / z)];
    let grad_clamped = DVec2::new(-by_row[0].dot(forward), -by_row[1].dot(forward));
    let free = DVec2::select(seen.slope.cmpeq(seen.clamped), grad_clamped, DVec2::ZERO);
    let grad_slope = grad_mean * focal + free;
    let grad_xy = grad_slope / z;
    let grad_z = sums[9]
        - grad_xy.dot(seen.slope)
        - (grad_jacobian_u.dot(f.jacobian_u) + grad_jacobian_v.dot(f.jacobian_v)) / z;
    let grad_p = grad_xy.extend(grad_z);

    let offset = from_camera(frame, gaussian.mean);
    let (distance, direction) = (offset.length(), offset.normalize());
    let (coefficients, basis) = (sh_at(sh, index, features), sh_basis(direction));
    let colour: DVec3 = coefficients.iter().zip(basis).map(|(&c, y)| c * y).sum::<DVec3>() + 0.5;
    let grad_colour =
        DVec3::select(colour.cmpge(DVec3::ZERO), DVec3::new(sums[6], sums[7], sums[8]), DVec3::ZERO);
    let grad_direction = sh_gradient(&coefficients, direction, grad_colour);
    let grad_offset = grad_direction.reject_from_normalized(direction) / distance;

    let rows = [rotation_row(frame, 0), rotation_row(frame, 1), forward];
    let grad_world = grad_p.x * rows[0] + grad_p.y * rows[1] + grad_p.z * rows[2] + grad_offset;
    let grad_logit = grad_ln_opacity * sigmoid(-gaussian.logit);
    // By D: p ← D p, and the rows of the rotation in the Jacobian likewise.
    let rotation = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
    let by_row = by_row.map(|by| rotation * by);
    let vectors = [
        grad_p.x * seen.p + by_row[0],
        grad_p.y * seen.p + by_row[1],
        grad_p.z * seen.p - seen.clamped.x * by_row[0] - seen.clamped.y * by_row[1],
        grad_p,
        -grad_offset,
    ];
    let ([x, y, z], [qw, qx, qy, qz]) = (grad_world.to_array(), grad_quaternion);
    let [s0, s1, s2] = grad_log_scale.to_array();
    Contribution {
        geometry: [x, y, z, qw, qx, qy, qz, s0, s1, s2, grad_logit],
        sh: basis[..coefficients.len()].iter().flat_map(|y| (*y * grad_colour).to_array()).collect(),
        pose: std::array::from_fn(|i| vectors[i / 3][i % 3]),
    }
}

/// The derivatives of ln √(det_sharp / det) by u and v.
fn ln_compensation_gradient(frame: &Frame, f: &Footprint) -> [DVec3; 2] {
    let cross = f.u.cross(f.v);
    let eps2d = f64::from(frame.eps2d);
    // 1/det_sharp - 1/det, without the difference of what is nearly the same.
    let difference = (eps2d * (f.u.dot(f.u) + f.v.dot(f.v)) + eps2d * eps2d) / (f.det_sharp * f.det);
    [
        f.v.cross(cross) * difference - f.u * (eps2d / f.det),
        cross.cross(f.u) * difference - f.v * (eps2d / f.det),
    ]
}

/// By a quaternion of unit norm, across it, given the derivatives by its matrix.
fn quaternion_gradient(q: [f64; 4], grad: DMat3) -> [f64; 4] {
    let [w, x, y, z] = q;
    // The derivatives of the matrix by each of the four, columns as written.
    let matrices = [
        [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]],
        [[0.0, y, z], [y, -2.0 * x, w], [z, -w, -2.0 * x]],
        [[-2.0 * y, x, -w], [x, 0.0, z], [w, z, -2.0 * y]],
        [[-2.0 * z, w, x], [-w, -2.0 * z, y], [x, y, 0.0]],
    ];
    let free =
        matrices.map(|columns| 2.0 * (0..3).map(|k| DVec3::from(columns[k]).dot(grad.col(k))).sum::<f64>());
    let along: f64 = q.iter().zip(free).map(|(q, free)| q * free).sum();
    std::array::from_fn(|i| free[i] - q[i] * along)
}

/// A derivative that does not fit f32 is not known: it counts as zero.
fn defined(x: f64) -> f32 {
    let x = x as f32;
    if x.is_finite() { x } else { 0.0 }
}
