//! Elementary functions without branches or calls, so that loops over them become vector instructions.

use multiversion::{multiversion, target::target_cfg_f};

/// a b + c, fused where the instruction set can (elsewhere a fused one would be a library call).
#[inline(always)]
pub(super) fn mul_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// e^x for x ≤ 80, relative error below 3e-7 where the result is a normal number, 0 below about -87.
#[inline(always)]
pub(super) fn exp<const FMA: bool>(x: f32) -> f32 {
    // Adding 1.5 · 2²³ rounds to the nearest integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    // log2 e in two parts, of which the first is the nearest f32.
    const HIGH: f32 = std::f32::consts::LOG2_E;
    const LOW: f32 = (std::f64::consts::LOG2_E - std::f32::consts::LOG2_E as f64) as f32;
    // 2^f on [-½, ½]: weighted least squares on Chebyshev nodes, relative error 2e-9 before rounding.
    const P: [f32; 7] = [
        1.0,
        std::f32::consts::LN_2,
        0.240_226_48,
        0.055_503_324,
        0.009_618_437,
        0.001_339_887_4,
        0.000_153_533_59,
    ];
    let x = x.max(-87.3);
    let rounded = mul_add::<FMA>(x, HIGH, ROUND);
    let n = rounded - ROUND;
    let f = mul_add::<FMA>(x, LOW, mul_add::<FMA>(x, HIGH, -n));
    let mut p = P[6];
    p = mul_add::<FMA>(p, f, P[5]);
    p = mul_add::<FMA>(p, f, P[4]);
    p = mul_add::<FMA>(p, f, P[3]);
    p = mul_add::<FMA>(p, f, P[2]);
    p = mul_add::<FMA>(p, f, P[1]);
    p = mul_add::<FMA>(p, f, P[0]);
    f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23))
}

/// The error function, absolute error below 2e-7.
#[inline(always)]
pub(super) fn erf<const FMA: bool>(x: f32) -> f32 {
    // erfc(x) = exp(-x q(x)) on [0, 4], beyond which erf is 1 in f32; q by weighted least squares on Chebyshev
    // nodes, so that the error of erf is 9e-9 before rounding.
    const Q: [f32; 9] = [
        1.128_379_8,
        0.636_607_5,
        0.102_854_57,
        -0.019_382_427,
        0.000_203_152_5,
        0.001_344_343,
        -0.000_472_881_86,
        7.654_182e-5,
        -5.018_657e-6,
    ];
    let a = x.abs().min(4.0);
    let mut q = Q[8];
    q = mul_add::<FMA>(q, a, Q[7]);
    q = mul_add::<FMA>(q, a, Q[6]);
    q = mul_add::<FMA>(q, a, Q[5]);
    q = mul_add::<FMA>(q, a, Q[4]);
    q = mul_add::<FMA>(q, a, Q[3]);
    q = mul_add::<FMA>(q, a, Q[2]);
    q = mul_add::<FMA>(q, a, Q[1]);
    q = mul_add::<FMA>(q, a, Q[0]);
    (1.0 - exp::<FMA>(-a * q)).copysign(x)
}

/// What follows a sum: applied to each value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::depthsplat) enum Activation {
    /// None.
    Identity,
    /// max(x, 0).
    Relu,
    /// x Φ(x) with the exact normal distribution.
    Gelu,
    /// x / (1 + e^-x).
    Silu,
}

#[inline(always)]
fn apply_with<const FMA: bool>(activation: Activation, values: &mut [f32]) {
    match activation {
        Activation::Identity => {}
        Activation::Relu => values.iter_mut().for_each(|v| *v = v.max(0.0)),
        Activation::Gelu => values.iter_mut().for_each(|v| {
            let half = 0.5 * *v;
            *v = mul_add::<FMA>(half, erf::<FMA>(*v * std::f32::consts::FRAC_1_SQRT_2), half);
        }),
        Activation::Silu => values.iter_mut().for_each(|v| *v /= 1.0 + exp::<FMA>((-*v).min(80.0))),
    }
}

/// Applies an activation in place.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn activate(activation: Activation, values: &mut [f32]) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        apply_with::<true>(activation, values);
    } else {
        apply_with::<false>(activation, values);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// erf by its series (|x| ≤ 3) or continued fraction, f64.
    fn erf64(x: f64) -> f64 {
        let a = x.abs();
        let value = if a < 3.0 {
            let mut term = a;
            let mut sum = a;
            for n in 1..200 {
                term *= -a * a / f64::from(n);
                sum += term / f64::from(2 * n + 1);
            }
            sum * 2.0 / std::f64::consts::PI.sqrt()
        } else {
            let mut fraction = a;
            for n in (1..80).rev() {
                fraction = a + f64::from(n) / 2.0 / fraction;
            }
            1.0 - (-a * a).exp() / fraction / std::f64::consts::PI.sqrt()
        };
        value.copysign(x)
    }

    #[test]
    fn functions_agree_with_f64() {
        for i in -40_000..=40_000 {
            let x = i as f32 * 2.5e-4;
            let error = f64::from(erf::<true>(x)) - erf64(f64::from(x));
            assert!(error.abs() < 3e-7, "erf({x}) is off by {error:e}");
            for found in [exp::<true>(x), exp::<false>(x)] {
                let expected = f64::from(x).exp();
                assert!((f64::from(found) / expected - 1.0).abs() < 1e-6, "exp({x}) = {found}");
            }
        }
        assert!(exp::<true>(-100.0) < 1.3e-38 && exp::<true>(f32::NEG_INFINITY) < 1.3e-38);
    }

    #[test]
    fn activations_agree_with_f64() {
        let xs: Vec<f32> = (-3000..3000).map(|i| i as f32 * 5e-3).collect();
        let silu = |x: f64| x / (1.0 + (-x).exp());
        let gelu = |x: f64| 0.5 * x * (1.0 + erf64(x / 2.0_f64.sqrt()));
        for (activation, exact) in [
            (Activation::Identity, &(|x| x) as &dyn Fn(f64) -> f64),
            (Activation::Relu, &|x: f64| x.max(0.0)),
            (Activation::Gelu, &gelu),
            (Activation::Silu, &silu),
        ] {
            let mut found = xs.clone();
            activate(activation, &mut found);
            for (&x, &y) in xs.iter().zip(&found) {
                let expected = exact(f64::from(x));
                assert!((f64::from(y) - expected).abs() < 2e-6, "{activation:?}({x}) = {y}, not {expected}");
            }
        }
        let mut extreme = [f32::NAN, -1e30, 1e30];
        activate(Activation::Silu, &mut extreme);
        assert!(extreme[0].is_nan() && extreme[1].abs() < 1e-4 && extreme[2] == 1e30);
    }
}
