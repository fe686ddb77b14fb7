//! What kernels are made of: loops over slices in vectors, and elementary functions of vectors without branches or calls.
//!
//! Vector instructions are only used where all is inlined into the function that is compiled for them. Closures that are
//! given to these loops therefore have `#[inline(always)]`: one that is left outside calls a function for each instruction.

use pulp::{Simd, bytemuck, cast};

/// `yes` where the mask is set, `no` elsewhere.
///
/// As [`neg`] and [`abs`] it stands in for pulp's default method, which is merely `#[inline]`: whether that is inlined, the compiler
/// decides, and where it is not, each vector makes two calls.
///
/// If one operand was read from memory and the result goes back there, the compiler may turn load, select and store into one masked store,
/// which is slow on AMD processors with AVX2 (docs/bench/instruction-sets.md, *Masked stores*): keep such a number in a register, or change it
/// by arithmetic that leaves it as it is elsewhere.
#[inline(always)]
pub fn select<S: Simd>(simd: S, mask: S::m32s, yes: S::f32s, no: S::f32s) -> S::f32s {
    cast(simd.select_u32s(mask, cast(yes), cast(no)))
}

/// `value` where the mask is set, 0 elsewhere: one instruction less than [`select`] where masks are vectors.
#[inline(always)]
pub fn keep<S: Simd>(simd: S, mask: S::m32s, value: S::f32s) -> S::f32s {
    if size_of::<S::m32s>() == size_of::<S::f32s>() {
        simd.and_f32s(bytemuck::cast(mask), value)
    } else {
        select(simd, mask, value, simd.splat_f32s(0.0))
    }
}

/// -x.
#[inline(always)]
pub fn neg<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    simd.xor_f32s(x, simd.splat_f32s(-0.0))
}

/// |x|.
#[inline(always)]
pub fn abs<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    simd.and_f32s(x, simd.splat_f32s(f32::from_bits(!(1 << 31))))
}

/// Replaces every value by f(value). The last values, fewer than a vector, are seen by `f` with others beside them that
/// are thrown away.
#[inline(always)]
pub fn map<S: Simd>(simd: S, values: &mut [f32], f: impl Fn(S::f32s) -> S::f32s) {
    let (vectors, rest) = S::as_mut_simd_f32s(values);
    for v in vectors {
        *v = f(*v);
    }
    if !rest.is_empty() {
        let v = simd.partial_load_f32s(rest);
        simd.partial_store_f32s(rest, f(v));
    }
}

/// Replaces every value by f(value, other).
///
/// # Panics
/// If the lengths do not agree.
#[inline(always)]
pub fn map2<S: Simd>(simd: S, values: &mut [f32], other: &[f32], f: impl Fn(S::f32s, S::f32s) -> S::f32s) {
    assert_eq!(values.len(), other.len(), "values side by side");
    let (vectors, rest) = S::as_mut_simd_f32s(values);
    let (others, other_rest) = S::as_simd_f32s(other);
    for (v, o) in vectors.iter_mut().zip(others) {
        *v = f(*v, *o);
    }
    if !rest.is_empty() {
        let (v, o) = (simd.partial_load_f32s(rest), simd.partial_load_f32s(other_rest));
        simd.partial_store_f32s(rest, f(v, o));
    }
}

/// Replaces every value by f(value, a, b).
///
/// # Panics
/// If the lengths do not agree.
#[inline(always)]
pub fn map3<S: Simd>(
    simd: S,
    values: &mut [f32],
    (a, b): (&[f32], &[f32]),
    f: impl Fn(S::f32s, S::f32s, S::f32s) -> S::f32s,
) {
    assert!(values.len() == a.len() && values.len() == b.len(), "values side by side");
    let (vectors, rest) = S::as_mut_simd_f32s(values);
    let ((va, rest_a), (vb, rest_b)) = (S::as_simd_f32s(a), S::as_simd_f32s(b));
    for ((v, a), b) in vectors.iter_mut().zip(va).zip(vb) {
        *v = f(*v, *a, *b);
    }
    if !rest.is_empty() {
        let [v, a, b] =
            [simd.partial_load_f32s(rest), simd.partial_load_f32s(rest_a), simd.partial_load_f32s(rest_b)];
        simd.partial_store_f32s(rest, f(v, a, b));
    }
}

/// Writes f(a, b, c).
///
/// # Panics
/// If the lengths do not agree.
#[inline(always)]
pub fn write3<S: Simd>(
    simd: S,
    out: &mut [f32],
    (a, b, c): (&[f32], &[f32], &[f32]),
    f: impl Fn(S::f32s, S::f32s, S::f32s) -> S::f32s,
) {
    assert!(out.len() == a.len() && out.len() == b.len() && out.len() == c.len(), "values side by side");
    let (vectors, rest) = S::as_mut_simd_f32s(out);
    let ((va, rest_a), (vb, rest_b), (vc, rest_c)) =
        (S::as_simd_f32s(a), S::as_simd_f32s(b), S::as_simd_f32s(c));
    for (((out, a), b), c) in vectors.iter_mut().zip(va).zip(vb).zip(vc) {
        *out = f(*a, *b, *c);
    }
    if !rest.is_empty() {
        let [a, b, c] =
            [simd.partial_load_f32s(rest_a), simd.partial_load_f32s(rest_b), simd.partial_load_f32s(rest_c)];
        simd.partial_store_f32s(rest, f(a, b, c));
    }
}

/// The sum of term(value) over all values, in four vectors of sums, so that no addition waits for the one before; in an
/// order that depends on nothing but the instruction set. term(0) is to be 0.
#[inline(always)]
pub fn sum<S: Simd>(simd: S, values: &[f32], term: impl Fn(S::f32s) -> S::f32s) -> f32 {
    let (vectors, rest) = S::as_simd_f32s(values);
    let (fours, more) = vectors.as_chunks::<4>();
    let mut sums = [simd.splat_f32s(0.0); 4];
    for four in fours {
        for (sum, v) in sums.iter_mut().zip(four) {
            *sum = simd.add_f32s(*sum, term(*v));
        }
    }
    for (sum, v) in sums.iter_mut().zip(more) {
        *sum = simd.add_f32s(*sum, term(*v));
    }
    if !rest.is_empty() {
        // The vectors before it took the first few sums.
        sums[3] = simd.add_f32s(sums[3], masked(simd, rest, term));
    }
    let [a, b, c, d] = sums;
    simd.reduce_sum_f32s(simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d)))
}

/// The sum of term(value) over all values, and that of its square, in the order of [`sum`].
#[inline(always)]
pub fn sum_and_squares<S: Simd>(simd: S, values: &[f32], term: impl Fn(S::f32s) -> S::f32s) -> (f32, f32) {
    let (vectors, rest) = S::as_simd_f32s(values);
    let (fours, more) = vectors.as_chunks::<4>();
    let zero = simd.splat_f32s(0.0);
    let (mut sums, mut squares) = ([zero; 4], [zero; 4]);
    for four in fours {
        for ((sum, square), v) in sums.iter_mut().zip(&mut squares).zip(four) {
            let t = term(*v);
            *sum = simd.add_f32s(*sum, t);
            *square = simd.mul_add_e_f32s(t, t, *square);
        }
    }
    for ((sum, square), v) in sums.iter_mut().zip(&mut squares).zip(more) {
        let t = term(*v);
        *sum = simd.add_f32s(*sum, t);
        *square = simd.mul_add_e_f32s(t, t, *square);
    }
    if !rest.is_empty() {
        let t = masked(simd, rest, term);
        sums[3] = simd.add_f32s(sums[3], t);
        squares[3] = simd.mul_add_e_f32s(t, t, squares[3]);
    }
    let ([a, b, c, d], [e, f, g, h]) = (sums, squares);
    let sum = simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d));
    let square = simd.add_f32s(simd.add_f32s(e, f), simd.add_f32s(g, h));
    (simd.reduce_sum_f32s(sum), simd.reduce_sum_f32s(square))
}

/// term(value) of fewer values than a vector has, with zeros beside them.
#[inline(always)]
fn masked<S: Simd>(simd: S, rest: &[f32], term: impl Fn(S::f32s) -> S::f32s) -> S::f32s {
    let live = simd.mask_between_m32s(0, rest.len() as u32).mask();
    select(simd, live, term(simd.partial_load_f32s(rest)), simd.splat_f32s(0.0))
}

/// The product of two rows.
///
/// # Panics
/// If the lengths do not agree.
#[inline(always)]
pub fn dot<S: Simd>(simd: S, a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len(), "rows of one length");
    let ((va, rest_a), (vb, rest_b)) = (S::as_simd_f32s(a), S::as_simd_f32s(b));
    let mut sums = [simd.splat_f32s(0.0); 4];
    let ((fours_a, more_a), (fours_b, more_b)) = (va.as_chunks::<4>(), vb.as_chunks::<4>());
    for (a, b) in fours_a.iter().zip(fours_b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum = simd.mul_add_e_f32s(*a, *b, *sum);
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(more_a).zip(more_b) {
        *sum = simd.mul_add_e_f32s(*a, *b, *sum);
    }
    if !rest_a.is_empty() {
        let b = simd.partial_load_f32s(rest_b);
        sums[3] = simd.add_f32s(
            sums[3],
            masked(
                simd,
                rest_a,
                #[inline(always)]
                |a| simd.mul_f32s(a, b),
            ),
        );
    }
    let [a, b, c, d] = sums;
    simd.reduce_sum_f32s(simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d)))
}

/// The largest value, minus infinity of none; what is not a number may be passed over.
#[inline(always)]
pub fn largest<S: Simd>(simd: S, values: &[f32]) -> f32 {
    let (vectors, rest) = S::as_simd_f32s(values);
    let mut most = simd.splat_f32s(f32::NEG_INFINITY);
    for v in vectors {
        most = simd.max_f32s(*v, most);
    }
    rest.iter().fold(simd.reduce_max_f32s(most), |most, &v| most.max(v))
}

/// max(x, 0) that keeps what is not a number.
#[inline(always)]
pub fn relu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let zero = simd.splat_f32s(0.0);
    select(simd, simd.less_than_f32s(x, zero), zero, x)
}

/// a + b x + c x² ..., the last coefficient first.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(simd: S, coefficients: [f32; N], x: S::f32s) -> S::f32s {
    let mut p = simd.splat_f32s(coefficients[0]);
    for &coefficient in &coefficients[1..] {
        p = simd.mul_add_e_f32s(p, x, simd.splat_f32s(coefficient));
    }
    p
}

/// e^x for x ≤ 88, relative error below 2e-7; 0 below -87.3, where it would not be a normal number; e^88 above 88.
#[inline(always)]
pub fn exp<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // Adding 1.5 · 2²³ rounds to the nearest integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts: the first has 10 bits, so that its products with exponents are exact.
    const HIGH: f32 = 0.693_359_4;
    const LOW: f32 = (std::f64::consts::LN_2 - HIGH as f64) as f32;
    const LOWEST: f32 = -87.3;
    const HIGHEST: f32 = 88.0;
    // Taylor's series on |f| ≤ ln 2 / 2: the first term left out is 5e-9.
    const SERIES: [f32; 8] = [1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];
    // Not a number stays so through every step.
    let highest = simd.splat_f32s(HIGHEST);
    let clamped = select(simd, simd.greater_than_f32s(x, highest), highest, x);
    let rounded =
        simd.mul_add_e_f32s(clamped, simd.splat_f32s(std::f32::consts::LOG2_E), simd.splat_f32s(ROUND));
    let n = simd.sub_f32s(rounded, simd.splat_f32s(ROUND));
    let f = simd.mul_add_e_f32s(
        n,
        simd.splat_f32s(-LOW),
        simd.mul_add_e_f32s(n, simd.splat_f32s(-HIGH), clamped),
    );
    let p = polynomial(simd, SERIES, f);
    let bits = simd.wrapping_dyn_shl_u32s(cast(rounded), simd.splat_u32s(23));
    let scale: S::f32s = cast(simd.add_u32s(bits, simd.splat_u32s(1.0_f32.to_bits())));
    // Below the lowest the scale is of no meaning.
    select(
        simd,
        simd.less_than_f32s(x, simd.splat_f32s(LOWEST)),
        simd.splat_f32s(0.0),
        simd.mul_f32s(p, scale),
    )
}

/// x Φ(x), of the normal distribution; absolute error below 2e-7 + |x| 6e-8.
#[inline(always)]
pub fn gelu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // The tail is nothing there, but infinity times nothing would be no number.
    let t = simd.min_f32s(abs(simd, x), simd.splat_f32s(FARTHEST));
    let (tail, _) = lower_tail(simd, t);
    simd.negate_mul_add_e_f32s(t, tail, relu(simd, x))
}

/// [`gelu`] and its derivative Φ(x) + x φ(x), whose absolute error is below 6e-7.
#[inline(always)]
pub fn gelu_and_slope<S: Simd>(simd: S, x: S::f32s) -> (S::f32s, S::f32s) {
    let (t, farthest) = (abs(simd, x), simd.splat_f32s(FARTHEST));
    // Not a number stays so.
    let t = select(simd, simd.greater_than_f32s(t, farthest), farthest, t);
    let (tail, root) = lower_tail(simd, t);
    // φ(t) is the derivative of 1 / P⁸ but for its sign: 8 P' / P⁹.
    let bell = simd.mul_f32s(simd.mul_f32s(tail, root), polynomial(simd, TAIL_SLOPE, t));
    let below = simd.negate_mul_add_e_f32s(t, bell, tail);
    let negative = simd.less_than_f32s(x, simd.splat_f32s(0.0));
    let slope = select(simd, negative, below, simd.sub_f32s(simd.splat_f32s(1.0), below));
    (simd.negate_mul_add_e_f32s(t, tail, relu(simd, x)), slope)
}

/// From here on tails of the normal distribution are 0.
const FARTHEST: f32 = 1e3;

/// P of [`lower_tail`], by least squares on Chebyshev nodes up to 7, weights iterated towards the least maximum of the error times max(t, 0.6).
const TAIL: [f32; 9] = [
    3.041_216e-6,
    -1.624_414_7e-5,
    9.596_163e-5,
    0.000_149_377,
    0.001_028_225_9,
    0.009_402_147,
    0.048_829_72,
    0.108_760_804,
    1.090_507_7,
];

/// 8 P'.
const TAIL_SLOPE: [f32; 8] = {
    let mut slope = [0.0; 8];
    let mut i = 0;
    while i < slope.len() {
        slope[i] = 8.0 * (slope.len() - i) as f32 * TAIL[i];
        i += 1;
    }
    slope
};

/// Φ(-t) for 0 ≤ t ≤ [`FARTHEST`] as 1 / P(t)⁸, and 1 / P(t). Absolute error below 6e-7, and below 2e-7 / t: a polynomial is far nearer to the eighth
/// root than to the tail, and needs no exponential.
#[inline(always)]
fn lower_tail<S: Simd>(simd: S, t: S::f32s) -> (S::f32s, S::f32s) {
    let root = simd.div_f32s(simd.splat_f32s(1.0), polynomial(simd, TAIL, t));
    let square = simd.mul_f32s(root, root);
    let fourth = simd.mul_f32s(square, square);
    (simd.mul_f32s(fourth, fourth), root)
}

/// x / (1 + e^-x).
#[inline(always)]
pub fn silu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    simd.div_f32s(x, simd.add_f32s(simd.splat_f32s(1.0), exp(simd, neg(simd, x))))
}

/// The hyperbolic tangent, absolute error below 2e-7.
#[inline(always)]
pub fn tanh<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // Of ∣x∣ the exponential is at most 1; the sign is put back.
    let sign = simd.and_f32s(x, simd.splat_f32s(-0.0));
    let e = exp(simd, simd.mul_f32s(simd.splat_f32s(-2.0), abs(simd, x)));
    let one = simd.splat_f32s(1.0);
    simd.or_f32s(simd.div_f32s(simd.sub_f32s(one, e), simd.add_f32s(one, e)), sign)
}
