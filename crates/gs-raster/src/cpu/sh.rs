//! Real spherical harmonics with the Condon–Shortley sign, degree 0 to 3, m = -l..l, as the 3DGS PLY stores them.

use cpu_kernels::lanes::{F32s, Lanes};
use gs_scene::SH_C0;

const C1: f32 = 0.488_602_5;
const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
const C3: [f32; 7] =
    [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_34, -0.457_045_8, 1.445_305_7, -0.590_043_6];

/// The most coefficients per channel.
pub(super) const COEFFICIENTS_MAX: usize = 16;

/// The basis in a direction of unit length; the first (DEGREE+1)² numbers are meant.
#[inline(always)]
pub(super) fn basis<const DEGREE: usize, S: Lanes>([x, y, z]: [F32s<S>; 3]) -> [F32s<S>; COEFFICIENTS_MAX] {
    let mut basis = [x.all(0.0); COEFFICIENTS_MAX];
    basis[0] = x.all(SH_C0);
    if DEGREE >= 1 {
        basis[1] = -C1 * y;
        basis[2] = C1 * z;
        basis[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if DEGREE >= 2 {
        basis[4] = C2[0] * x * y;
        basis[5] = C2[1] * y * z;
        basis[6] = C2[2] * (2.0 * zz - xx - yy);
        basis[7] = C2[3] * x * z;
        basis[8] = C2[4] * (xx - yy);
    }
    if DEGREE >= 3 {
        basis[9] = C3[0] * y * (3.0 * xx - yy);
        basis[10] = C3[1] * x * y * z;
        basis[11] = C3[2] * y * (4.0 * zz - xx - yy);
        basis[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        basis[13] = C3[4] * x * (4.0 * zz - xx - yy);
        basis[14] = C3[5] * z * (xx - yy);
        basis[15] = C3[6] * x * (xx - 3.0 * yy);
    }
    basis
}

/// The derivative of Σ weight_k Y_k by the direction, its three numbers taken as independent.
#[inline(always)]
pub(super) fn direction_gradient<const DEGREE: usize, S: Lanes>(
    [x, y, z]: [F32s<S>; 3],
    weight: &[F32s<S>; COEFFICIENTS_MAX],
) -> [F32s<S>; 3] {
    let w = weight;
    let (zero, one) = (x.all(0.0), x.all(1.0));
    let mut gradient = [zero; 3];
    // A macro, because a closure that is called so often is not inlined.
    macro_rules! add {
        ($k:expr, $c:expr, $by:expr) => {{
            let (weight, by) = (w[$k] * $c, $by);
            for axis in 0..3 {
                gradient[axis] = weight.mul_add(by[axis], gradient[axis]);
            }
        }};
    }
    if DEGREE >= 1 {
        add!(1, -C1, [zero, one, zero]);
        add!(2, C1, [zero, zero, one]);
        add!(3, -C1, [one, zero, zero]);
    }
    if DEGREE >= 2 {
        add!(4, C2[0], [y, x, zero]);
        add!(5, C2[1], [zero, z, y]);
        add!(6, C2[2], [-2.0 * x, -2.0 * y, 4.0 * z]);
        add!(7, C2[3], [z, zero, x]);
        add!(8, C2[4], [2.0 * x, -2.0 * y, zero]);
    }
    if DEGREE >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        add!(9, C3[0], [6.0 * x * y, 3.0 * (xx - yy), zero]);
        add!(10, C3[1], [y * z, x * z, x * y]);
        add!(11, C3[2], [-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z]);
        add!(12, C3[3], [-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy]);
        add!(13, C3[4], [4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z]);
        add!(14, C3[5], [2.0 * x * z, -2.0 * y * z, xx - yy]);
        add!(15, C3[6], [3.0 * (xx - yy), -6.0 * x * y, zero]);
    }
    gradient
}

#[cfg(test)]
mod tests {
    use super::*;
    use cpu_kernels::pulp::Scalar;

    #[test]
    fn the_derivative_is_the_limit_of_differences() {
        let weight: [f32; COEFFICIENTS_MAX] = std::array::from_fn(|k| ((k * 7 + 3) % 11) as f32 / 11.0 - 0.4);
        let lanes = |d: [f32; 3]| d.map(|number| F32s::splat(Scalar, number));
        let radiance = |d: [f32; 3]| -> f64 {
            let basis = basis::<3, _>(lanes(d)).map(F32s::number);
            basis.iter().zip(&weight).map(|(b, w)| f64::from(*b) * f64::from(*w)).sum()
        };
        let d = [0.48, -0.6, 0.64];
        let found = direction_gradient::<3, _>(lanes(d), &weight.map(|number| F32s::splat(Scalar, number)));
        let found = found.map(F32s::number);
        for axis in 0..3 {
            let step = 1.0 / 64.0;
            let moved = |sign: f32| {
                let mut moved = d;
                moved[axis] += sign * step;
                radiance(moved)
            };
            // Exact for cubics up to the third derivative, which Richardson's step removes.
            let wide = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
            let wider = (moved(2.0) - moved(-2.0)) / (4.0 * f64::from(step));
            let expected = (4.0 * wide - wider) / 3.0;
            assert!((f64::from(found[axis]) - expected).abs() < 1e-4, "{axis}: {} {expected}", found[axis]);
        }
    }
}
