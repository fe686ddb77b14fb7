//! Elementary functions without branches or calls, so that loops over them become vector instructions.

use multiversion::{multiversion, target::target_cfg_f};

/// a b + c, fused where the instruction set can (elsewhere a fused one would be a library call).
#[inline(always)]
pub(super) fn mul_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// e^x for x ≤ 88, relative error below 2e-7; 0 below -87.3, where it would not be a normal number.
#[inline(always)]
pub(super) fn exp<const FMA: bool>(x: f32) -> f32 {
    // Adding 1.5 · 2²³ rounds to the nearest integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts: the first has 10 bits, so that its products with exponents are exact.
    const HIGH: f32 = 0.693_359_4;
    const LOW: f32 = (std::f64::consts::LN_2 - HIGH as f64) as f32;
    const LOWEST: f32 = -87.3;
    // Not a number stays so through every step.
    let clamped = x.clamp(LOWEST, 88.0);
    let rounded = mul_add::<FMA>(clamped, std::f32::consts::LOG2_E, ROUND);
    let n = rounded - ROUND;
    let f = mul_add::<FMA>(n, -LOW, mul_add::<FMA>(n, -HIGH, clamped));
    // Taylor's series on |f| ≤ ln 2 / 2: the first term left out is 5e-9.
    let mut p = 1.0 / 5040.0;
    for term in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = mul_add::<FMA>(p, f, term);
    }
    let scale = f32::from_bits((rounded.to_bits() << 23).wrapping_add(1.0_f32.to_bits()));
    if x < LOWEST { 0.0 } else { p * scale }
}

/// x Φ(x) and its derivative Φ(x) + x φ(x), of the normal distribution; absolute error of both below 2e-7 + |x| 6e-8.
#[inline(always)]
fn gelu<const FMA: bool>(x: f32) -> (f32, f32) {
    // Φ(-t) = e^(-t²/2) s P(s) with s = 1 / (1 + 0.35 t), relative error 4e-8 up to t = 13.3, where it leaves the
    // range of f32. P by least squares on Chebyshev nodes in s, weights iterated towards the least maximum.
    const P: [f32; 9] = [
        -0.029_115_13,
        0.143_818_96,
        -0.255_392_1,
        0.158_797_76,
        -0.022_844_208,
        0.105_392_46,
        0.119_863_01,
        0.139_857_58,
        0.139_621_66,
    ];
    const PEAK: f32 = 0.398_942_3; // φ(0) = 1 / sqrt(2 π)
    let t = x.abs();
    let bell = exp::<FMA>(-0.5 * t * t);
    let s = 1.0 / mul_add::<FMA>(0.35, t, 1.0);
    let mut p = P[0];
    for &term in &P[1..] {
        p = mul_add::<FMA>(p, s, term);
    }
    let tail = bell * s * p;
    let normal = if x < 0.0 { tail } else { 1.0 - tail };
    (x * normal, mul_add::<FMA>(x * PEAK, bell, normal))
}

/// What follows the first of two linear layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Activation {
    /// max(x, 0).
    Relu,
    /// x Φ(x) with the exact normal distribution.
    Gelu,
}

impl Activation {
    /// Applies it to every value.
    pub(super) fn apply(self, values: &mut [f32]) {
        match self {
            Self::Relu => values.iter_mut().for_each(|v| *v = relu(*v)),
            Self::Gelu => gelus(values),
        }
    }

    /// Applies it to every value, and multiplies `grad` by its derivative there.
    pub(super) fn apply_with_gradient(self, values: &mut [f32], grad: &mut [f32]) {
        match self {
            Self::Relu => {
                for (v, grad) in values.iter_mut().zip(grad) {
                    *grad = if *v > 0.0 { *grad } else { 0.0 };
                    *v = relu(*v);
                }
            }
            Self::Gelu => gelus_with_gradient(values, grad),
        }
    }
}

/// max(x, 0) that keeps what is not a number.
#[inline(always)]
pub(super) fn relu(x: f32) -> f32 {
    if x < 0.0 { 0.0 } else { x }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn gelus(values: &mut [f32]) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        values.iter_mut().for_each(|v| *v = gelu::<true>(*v).0);
    } else {
        values.iter_mut().for_each(|v| *v = gelu::<false>(*v).0);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
fn gelus_with_gradient(values: &mut [f32], grad: &mut [f32]) {
    let fused = cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma");
    for (v, grad) in values.iter_mut().zip(grad) {
        let (value, slope) = if fused { gelu::<true>(*v) } else { gelu::<false>(*v) };
        *v = value;
        *grad *= slope;
    }
}
