// Real spherical harmonics with the Condon-Shortley sign, m = -l..l, as the 3DGS PLY stores them.

override SH_DEGREE: u32;

const SH_C0: f32 = 0.28209479177387814;
const SH_C1: f32 = 0.4886025119029199;
const SH_C2_XY: f32 = 1.0925484305920792;
const SH_C2_ZZ: f32 = 0.31539156525252005;
const SH_C2_XX: f32 = 0.5462742152960396;
const SH_C3_Y3: f32 = -0.5900435899266435;
const SH_C3_XYZ: f32 = 2.890611442640554;
const SH_C3_YZZ: f32 = -0.4570457994644658;
const SH_C3_ZZZ: f32 = 0.3731763325901154;
const SH_C3_ZXX: f32 = 1.445305721320277;

fn sh_coefficients() -> u32 {
    return (SH_DEGREE + 1u) * (SH_DEGREE + 1u);
}

// The basis at a unit direction; entries beyond the degree are zero.
fn sh_basis(d: vec3f) -> array<f32, 16> {
    var y: array<f32, 16>;
    y[0] = SH_C0;
    if SH_DEGREE >= 1u {
        y[1] = -SH_C1 * d.y;
        y[2] = SH_C1 * d.z;
        y[3] = -SH_C1 * d.x;
    }
    let xx = d.x * d.x;
    let yy = d.y * d.y;
    let zz = d.z * d.z;
    if SH_DEGREE >= 2u {
        y[4] = SH_C2_XY * d.x * d.y;
        y[5] = -SH_C2_XY * d.y * d.z;
        y[6] = SH_C2_ZZ * (2.0 * zz - xx - yy);
        y[7] = -SH_C2_XY * d.x * d.z;
        y[8] = SH_C2_XX * (xx - yy);
    }
    if SH_DEGREE >= 3u {
        y[9] = SH_C3_Y3 * d.y * (3.0 * xx - yy);
        y[10] = SH_C3_XYZ * d.x * d.y * d.z;
        y[11] = SH_C3_YZZ * d.y * (4.0 * zz - xx - yy);
        y[12] = SH_C3_ZZZ * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        y[13] = SH_C3_YZZ * d.x * (4.0 * zz - xx - yy);
        y[14] = SH_C3_ZXX * d.z * (xx - yy);
        y[15] = SH_C3_Y3 * d.x * (xx - 3.0 * yy);
    }
    return y;
}
