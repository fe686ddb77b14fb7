//! Real spherical harmonics with the Condon–Shortley sign, degree 0 to 3, m = -l..l, as the 3DGS PLY stores them.

use gs_scene::{SH_C0, sh_coefficients};

const C1: f32 = 0.488_602_5;
const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
const C3: [f32; 7] =
    [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_34, -0.457_045_8, 1.445_305_7, -0.590_043_6];

/// ½ + Σ Y_k(direction) · sh_k per channel, before the cut at 0; `sh` is `[(degree+1)², 3]`, `direction` of unit length.
#[inline]
pub(crate) fn colour<const DEGREE: usize>(direction: [f32; 3], sh: &[f32]) -> [f32; 3] {
    // One check of the length instead of one per coefficient.
    let sh = &sh[..3 * sh_coefficients(DEGREE)];
    let [x, y, z] = direction;
    let mut rgb = [0.5; 3];
    let mut add = |k: usize, basis: f32| {
        rgb[0] += basis * sh[3 * k];
        rgb[1] += basis * sh[3 * k + 1];
        rgb[2] += basis * sh[3 * k + 2];
    };
    add(0, SH_C0);
    if DEGREE >= 1 {
        add(1, -C1 * y);
        add(2, C1 * z);
        add(3, -C1 * x);
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if DEGREE >= 2 {
        add(4, C2[0] * x * y);
        add(5, C2[1] * y * z);
        add(6, C2[2] * (2.0 * zz - xx - yy));
        add(7, C2[3] * x * z);
        add(8, C2[4] * (xx - yy));
    }
    if DEGREE >= 3 {
        add(9, C3[0] * y * (3.0 * xx - yy));
        add(10, C3[1] * x * y * z);
        add(11, C3[2] * y * (4.0 * zz - xx - yy));
        add(12, C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy));
        add(13, C3[4] * x * (4.0 * zz - xx - yy));
        add(14, C3[5] * z * (xx - yy));
        add(15, C3[6] * x * (xx - 3.0 * yy));
    }
    rgb
}
