//! Elementary functions of vectors, without branches or calls.

use cpu_kernels::lanes::{F64s, Lanes};
use cpu_kernels::pulp::{Scalar, Simd, cast};
use std::f64::consts::{LN_2, LOG2_E};

/// a b + c, fused where the instruction set can (elsewhere a fused one would be a library call).
#[inline(always)]
pub(super) fn mul_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// 1.5 · 2²³: added to a number it rounds to the nearest integer and leaves that in the low bits.
pub(super) const ROUND: f32 = 12_582_912.0;

/// 2^x for -126 ≤ x ≤ 1, relative error below 3e-7: a minimax polynomial on [-½, ½] times a power of two made in the
/// exponent bits. Beyond that range some number, which the caller masks out.
#[inline(always)]
pub(super) fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // The coefficient of the highest power first.
    const P: [f32; 6] = [0.001_327_647_3, 0.009_675_542, 0.055_507_13, 0.240_221_2, 0.693_146_94, 1.0];
    let number = |v: f32| simd.splat_f32s(v);
    let rounded = simd.add_f32s(x, number(ROUND));
    let f = simd.sub_f32s(x, simd.sub_f32s(rounded, number(ROUND)));
    // In pairs, so that one step waits for two others and not for five.
    let f2 = simd.mul_f32s(f, f);
    let pair = |i: usize| simd.mul_add_e_f32s(number(P[i]), f, number(P[i + 1]));
    let p = simd.mul_add_e_f32s(simd.mul_add_e_f32s(pair(0), f2, pair(2)), f2, pair(4));
    let power = simd.wrapping_dyn_shl_u32s(cast(rounded), simd.splat_u32s(23));
    cast(simd.add_u32s(cast(p), power))
}

/// A whole number from 0 to 2³², exclusive, as an integer; of any other number, some integer. A cast would saturate, for which there are
/// no vector instructions.
#[inline(always)]
pub(super) fn small_integer(x: f64) -> u32 {
    // Of numbers from 2⁵² on the low bits count ones.
    const ONES: f64 = 4_503_599_627_370_496.0;
    (x + ONES).to_bits() as u32
}

/// e^x, relative error below 1e-11 where the result is a normal number; 0 or a huge number beyond |x| = 690,
/// 0 if x is NaN.
#[inline(always)]
pub(super) fn exp<S: Lanes>(x: F64s<S>) -> F64s<S> {
    // Taylor's polynomial on |f| ≤ ln 2 / 2: the first term left out is 7e-12 of the sum.
    const TAYLOR: [f64; 10] = [
        1.0,
        1.0,
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5040.0,
        1.0 / 40320.0,
        1.0 / 362_880.0,
    ];
    // As in `exp2`, with 52 bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let x = x.clamp(-690.0, 690.0);
    let rounded = x * LOG2_E + ROUND;
    let f = (rounded - ROUND).mul_add(x.all(-LN_2), x);
    let mut p = x.all(TAYLOR[9]);
    for &term in TAYLOR[..9].iter().rev() {
        p = p.mul_add(f, x.all(term));
    }
    (p.to_bits() + rounded.to_bits().low_to_exponent()).as_f64s()
}

/// log₂ of a positive normal number, absolute error below 1e-10.
#[inline(always)]
pub(super) fn log2_of<S: Lanes>(x: F64s<S>) -> F64s<S> {
    // x = m 2^e with m in [√½, √2): the bits of √½ are subtracted, so that the exponent field changes at √2.
    const SQRT_HALF: u64 = std::f64::consts::FRAC_1_SQRT_2.to_bits();
    const EXPONENT: u64 = 0xfff << 52;
    let exponent_bits = (x.to_bits() - SQRT_HALF) & EXPONENT;
    let m = (x.to_bits() - exponent_bits).as_f64s();
    // The exponent as a number, without a conversion from 64-bit integers, which only the newest instruction sets
    // have: biased, in the low bits of 2⁵².
    const MAGIC: f64 = 4_503_599_627_370_496.0;
    let biased = (exponent_bits + (1023 << 52)).exponent_to_low();
    let e = (biased | MAGIC.to_bits()).as_f64s() - (MAGIC + 1023.0);
    // ln m = 2 artanh s; |s| ≤ 0.172.
    const SERIES: [f64; 6] = [1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0];
    let s = (m - 1.0) / (m + 1.0);
    let ss = s * s;
    let mut series = x.all(SERIES[0]);
    for &term in &SERIES[1..] {
        series = series.mul_add(ss, x.all(term));
    }
    (2.0 * LOG2_E * s).mul_add(series, e)
}

/// As [`log2_of`], of one number, for loops that the compiler vectorises.
#[inline(always)]
pub(crate) fn log2(x: f64) -> f64 {
    log2_of(F64s::splat(Scalar, x)).number()
}

#[cfg(test)]
mod tests {
    use super::*;
    use cpu_kernels::lanes::Kernel;
    use cpu_kernels::pulp::WithSimd;
    use cpu_kernels::{Isa, dispatch, lanes, vector};

    /// exp and log2 of numbers, sixteen at a time.
    struct Functions<'a>(&'a [f64]);

    impl Kernel for Functions<'_> {
        type Output = [Vec<f64>; 2];

        #[inline(always)]
        fn run<S: Lanes>(self, simd: S) -> [Vec<f64>; 2] {
            let mut found = [vec![0.0; self.0.len()], vec![0.0; self.0.len()]];
            for index in 0..self.0.len() / S::F64_LANES {
                let x = F64s::load(simd, self.0, index);
                exp(x).store(&mut found[0], index);
                log2_of(x).store(&mut found[1], index);
            }
            found
        }
    }

    /// Numbers, their exp and their log2 under each set.
    fn on_every_set(mut x: Vec<f64>) -> impl Iterator<Item = (Isa, f64, [f64; 2])> {
        x.resize(x.len().next_multiple_of(16), 1.0);
        Isa::available().into_iter().flat_map(move |isa| {
            let [exp, log2] = lanes::dispatch(isa, Functions(&x));
            let found = exp.into_iter().zip(log2);
            x.clone().into_iter().zip(found).map(move |(x, (exp, log2))| (isa, x, [exp, log2]))
        })
    }

    struct Exp2<'a>(&'a mut [f32]);

    impl WithSimd for Exp2<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            vector::map(simd, self.0, |x| exp2(simd, x));
        }
    }

    #[test]
    fn exp2_keeps_its_error_bound() {
        let x: Vec<f32> = (0..=1_000_000).map(|i| -126.0 + 127.0 * (i as f32 / 1e6)).collect();
        for isa in Isa::available() {
            let mut found = x.clone();
            dispatch(isa, Exp2(&mut found));
            for (x, found) in x.iter().zip(found) {
                let error = (f64::from(found) / f64::from(*x).exp2() - 1.0).abs();
                assert!(error < 3e-7, "{isa}: 2^{x}: {found}, relative error {error:e}");
            }
        }
    }

    #[test]
    fn exp_keeps_its_error_bound() {
        let x = (0..=1_000_000).map(|i| -690.0 + 1380.0 * (f64::from(i) / 1e6));
        for (isa, x, [found, _]) in on_every_set(x.collect()) {
            let error = (found / x.exp() - 1.0).abs();
            assert!(error < 1e-11, "{isa}: e^{x}: relative error {error:e}");
        }
        for (isa, x, [found, _]) in on_every_set(vec![0.0, -1e300, f64::NEG_INFINITY, 1e300]) {
            let (low, high) = match x {
                0.0 => (1.0, 1.0 + f64::EPSILON),
                1.0 => continue,
                x if x < 0.0 => (0.0, 1e-290),
                _ => (1e290, 1e300),
            };
            assert!((low..high).contains(&found), "{isa}: e^{x}: {found}");
        }
    }

    #[test]
    fn small_integers_are_those_of_a_cast() {
        for x in (0..5000)
            .chain((0..32).flat_map(|bit| [(1_u64 << bit) - 1, 1 << bit]))
            .chain([u64::from(u32::MAX)])
        {
            assert_eq!(small_integer(x as f64), x as u32);
        }
    }

    #[test]
    fn log2_keeps_its_error_bound() {
        let numbers = (0..=1_000_000).map(|i| f64::from(i) * 1e-6 + 1e-9);
        let numbers = numbers.chain((-1000..1000).map(|e| 1.37 * f64::from(e).exp2()));
        for (isa, x, [_, found]) in on_every_set(numbers.collect()) {
            let error = (found - x.log2()).abs();
            assert!(error < 1e-10, "{isa}: log2 {x}: error {error:e}");
            // The last numbers are 1.
            assert!(x != 1.0 || found == 0.0, "{isa}: log2 1: {found}");
        }
        assert_eq!(log2(1.0), 0.0);
    }
}
