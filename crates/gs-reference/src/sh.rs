//! Real spherical harmonics with the Condon-Shortley sign, m = -l..l, as the 3DGS PLY stores them, and their derivatives: what
//! the passes `project` and `project_backward` share.

use glam::DVec3;
use gs_shaders::Features;

const SH_C0: f64 = 0.28209479177387814;
const SH_C1: f64 = 0.4886025119029199;
const SH_C2_XY: f64 = 1.0925484305920792;
const SH_C2_ZZ: f64 = 0.31539156525252005;
const SH_C2_XX: f64 = 0.5462742152960396;
const SH_C3_Y3: f64 = -0.5900435899266435;
const SH_C3_XYZ: f64 = 2.890611442640554;
const SH_C3_YZZ: f64 = -0.4570457994644658;
const SH_C3_ZZZ: f64 = 0.3731763325901154;
const SH_C3_ZXX: f64 = 1.445305721320277;

pub(crate) fn sh_coefficients(features: Features) -> usize {
    let degree = features.sh_degree as usize;
    (degree + 1) * (degree + 1)
}

/// The coefficients of Gaussian `index`, `[K]` rgb each.
pub(crate) fn sh_at(sh: &[f32], index: usize, features: Features) -> Vec<DVec3> {
    let k = sh_coefficients(features);
    sh[index * k * 3..][..k * 3]
        .chunks_exact(3)
        .map(|c| DVec3::new(c[0].into(), c[1].into(), c[2].into()))
        .collect()
}

/// The basis at a unit direction.
pub(crate) fn sh_basis(d: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        SH_C0,
        -SH_C1 * y,
        SH_C1 * z,
        -SH_C1 * x,
        SH_C2_XY * x * y,
        -SH_C2_XY * y * z,
        SH_C2_ZZ * (2.0 * zz - xx - yy),
        -SH_C2_XY * x * z,
        SH_C2_XX * (xx - yy),
        SH_C3_Y3 * y * (3.0 * xx - yy),
        SH_C3_XYZ * x * y * z,
        SH_C3_YZZ * y * (4.0 * zz - xx - yy),
        SH_C3_ZZZ * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        SH_C3_YZZ * x * (4.0 * zz - xx - yy),
        SH_C3_ZXX * z * (xx - yy),
        SH_C3_Y3 * x * (xx - 3.0 * yy),
    ]
}

/// By the direction from which the colour is seen, taken as three independent numbers, given the colour's derivatives and the
/// coefficients.
pub(crate) fn sh_gradient(coefficients: &[DVec3], d: DVec3, grad_colour: DVec3) -> DVec3 {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let gradients = [
        DVec3::ZERO,
        -SH_C1 * DVec3::Y,
        SH_C1 * DVec3::Z,
        -SH_C1 * DVec3::X,
        SH_C2_XY * DVec3::new(y, x, 0.0),
        -SH_C2_XY * DVec3::new(0.0, z, y),
        SH_C2_ZZ * DVec3::new(-2.0 * x, -2.0 * y, 4.0 * z),
        -SH_C2_XY * DVec3::new(z, 0.0, x),
        SH_C2_XX * DVec3::new(2.0 * x, -2.0 * y, 0.0),
        SH_C3_Y3 * DVec3::new(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0),
        SH_C3_XYZ * DVec3::new(y * z, x * z, x * y),
        SH_C3_YZZ * DVec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        SH_C3_ZZZ * DVec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        SH_C3_YZZ * DVec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        SH_C3_ZXX * DVec3::new(2.0 * x * z, -2.0 * y * z, xx - yy),
        SH_C3_Y3 * DVec3::new(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0),
    ];
    coefficients.iter().zip(gradients).map(|(c, gradient)| c.dot(grad_colour) * gradient).sum()
}
