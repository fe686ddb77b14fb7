//! Elementary functions against f64.

use crate::sets;
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Activation, dispatch, vector};

/// erf by its series (|x| ≤ 3) or continued fraction, f64.
fn erf64(x: f64) -> f64 {
    let a = x.abs();
    let value = if a < 3.0 {
        let (mut term, mut sum) = (a, a);
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

fn gelu64(x: f64) -> f64 {
    0.5 * x * (1.0 + erf64(x / 2.0_f64.sqrt()))
}

fn silu64(x: f64) -> f64 {
    x / (1.0 + (-x).exp())
}

struct Exp<'a>(&'a mut [f32]);

impl WithSimd for Exp<'_> {
    type Output = ();

    fn with_simd<S: Simd>(self, simd: S) {
        vector::map(simd, self.0, |x| vector::exp(simd, x));
    }
}

#[test]
fn exponentials_agree_with_f64() {
    for isa in sets() {
        let xs: Vec<f32> = (-87_299..88_000).map(|i| i as f32 * 1e-3).collect();
        let mut found = xs.clone();
        dispatch(isa, Exp(&mut found));
        for (x, found) in xs.iter().zip(found) {
            let error = f64::from(found) / f64::from(*x).exp() - 1.0;
            assert!(error.abs() < 3e-7, "{isa}: exp({x}) = {found}, off by {error:e}");
        }
        let mut extreme = [f32::NAN, f32::NEG_INFINITY, -1e30, -88.0, f32::INFINITY, 1e30, -0.0];
        dispatch(isa, Exp(&mut extreme));
        let [nan, none @ .., infinite, huge, one] = extreme;
        assert!(nan.is_nan() && none == [0.0; 3] && one == 1.0, "{isa}: {extreme:?}");
        assert!(infinite == huge && (1.6e38..1.7e38).contains(&huge), "{isa}: {extreme:?}");
    }
}

#[test]
fn activations_and_their_slopes_agree_with_f64() {
    let functions: [(Activation, &dyn Fn(f64) -> f64); 5] = [
        (Activation::Identity, &|x| x),
        (Activation::Relu, &|x: f64| x.max(0.0)),
        (Activation::Gelu, &gelu64),
        (Activation::Silu, &silu64),
        (Activation::Tanh, &f64::tanh),
    ];
    // None is 0, where the slope of the ReLU is not defined; an odd number, so that a vector is left over.
    let xs: Vec<f32> = (-3000..3001).map(|i| i as f32 * 5e-3 + 1e-3).collect();
    for isa in sets() {
        for (activation, exact) in functions {
            let mut found = xs.clone();
            activation.apply(isa, &mut found);
            let (mut written, mut again) = (vec![7.0; xs.len()], vec![7.0; xs.len()]);
            activation.write(isa, &xs, &mut written);
            assert_eq!(written, found, "{isa}: {activation:?}");
            let mut slopes = vec![2.0; xs.len()];
            activation.write_with_gradient(isa, &xs, &mut again, &mut slopes);
            for (((x, y), again), slope) in xs.iter().zip(&found).zip(&again).zip(&slopes) {
                let x = f64::from(*x);
                let tolerance = 2.5e-7 + 1.2e-7 * x.abs();
                assert!((f64::from(*y) - exact(x)).abs() < tolerance, "{isa}: {activation:?}({x}) = {y}");
                assert!(
                    (f64::from(*again) - exact(x)).abs() < tolerance,
                    "{isa}: {activation:?}({x}) = {again}"
                );
                let step = 1e-4;
                let expected = (exact(x + step) - exact(x - step)) / step;
                assert!(
                    (f64::from(*slope) - expected).abs() < 2e-6 + tolerance,
                    "{isa}: {activation:?}'({x}) = {slope}"
                );
            }
        }
    }
}

#[test]
fn extremes_are_defined() {
    for isa in sets() {
        for activation in [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Silu] {
            let mut values = [f32::NAN, 1e30, -1e30, 0.0, f32::INFINITY];
            activation.apply(isa, &mut values);
            assert!(values[0].is_nan(), "{isa}: {activation:?} hides what is not a number");
            assert_eq!(
                (values[1], values[3], values[4]),
                (1e30, 0.0, f32::INFINITY),
                "{isa}: {activation:?}"
            );
            let least = if activation == Activation::Identity { -1e30 } else { 0.0 };
            assert!((values[2] - least).abs() < 1e-4, "{isa}: {activation:?}(-1e30) = {}", values[2]);
            activation.apply(isa, &mut []);
        }
        let far = [f32::NAN, f32::INFINITY, 1e30, f32::NEG_INFINITY, -1e30];
        let (mut values, mut slopes) = ([7.0; 5], [1.0; 5]);
        Activation::Gelu.write_with_gradient(isa, &far, &mut values, &mut slopes);
        assert!(values[0].is_nan() && slopes[0].is_nan(), "{isa}: {values:?} {slopes:?}");
        assert_eq!(values[1..], [f32::INFINITY, 1e30, 0.0, 0.0], "{isa}");
        assert_eq!(slopes[1..], [1.0, 1.0, 0.0, 0.0], "{isa}");
        let mut values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -0.0];
        Activation::Tanh.apply(isa, &mut values);
        assert!(values[0].is_nan(), "{isa}: tanh hides what is not a number");
        assert_eq!(values[1..], [1.0, -1.0, 1.0, 0.0], "{isa}");
    }
}
