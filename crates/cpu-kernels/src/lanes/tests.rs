use super::*;

/// Multiples of the lanes of every set.
const N: usize = 16;

/// Ordinary numbers, and those that comparisons and roundings stumble over.
const X: [f64; N] = [
    0.0,
    -0.0,
    1.0,
    -1.5,
    2.5,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    1e-310,
    1e300,
    -0.3,
    0.7,
    7.25,
    4_503_599_627_370_497.0,
    -3_377_699_720_527_872.5,
    1e20,
];
const Y: [f64; N] =
    [0.0, 0.0, f64::NAN, 2.0, -2.5, 1.0, 3.0, f64::NAN, 1.0, -1e300, -0.3, 0.5, 2.0, 1.0, 3.0, 1e20];

/// Numbers for every function, by name; of scalar code and of vectors.
type Found = Vec<(&'static str, [f64; N])>;

struct Everything;

impl Kernel for Everything {
    type Output = Found;

    #[inline(always)]
    fn run<S: Lanes>(self, simd: S) -> Found {
        let mut found = Found::new();
        let mut each = |name, f: &dyn Fn(F64s<S>, F64s<S>) -> F64s<S>| {
            let mut values = [0.0; N];
            for index in 0..N / S::F64_LANES {
                f(F64s::load(simd, &X, index), F64s::load(simd, &Y, index)).store(&mut values, index);
            }
            found.push((name, values));
        };
        let flag = |mask: Mask<S>| mask.select(F64s::splat(simd, 1.0), F64s::splat(simd, 0.0));
        each("add", &|x, y| x + y);
        each("sub", &|x, y| x - y);
        each("mul", &|x, y| x * y);
        each("div", &|x, y| x / y);
        each("neg", &|x, _| -x);
        each("with numbers", &|x, _| 2.0 * (x + 1.0) - (3.0 - x));
        each("mul_add", &|x, y| x.mul_add(y.all(4.0), y));
        each("recip", &|x, _| x.recip());
        each("sqrt", &|x, _| x.sqrt());
        each("max", &|x, y| x.max(y));
        each("min", &|x, y| x.min(y));
        each("clamp", &|x, _| x.clamp(-1.0, 2.0));
        each("floor", &|x, _| x.floor());
        each("ceil", &|x, _| x.ceil());
        each("below", &|x, y| flag(x.is_below(y)));
        each("at most", &|x, y| flag(x.is_at_most(y)));
        each("equal", &|x, y| flag(x.equals(y)));
        each("and", &|x, y| flag(x.is_below(y) & x.is_below(x.all(0.5))));
        each("or", &|x, y| flag(x.is_below(y) | x.is_below(x.all(0.5))));
        each("not", &|x, y| flag(!x.is_below(y)));
        each("exponents", &|x, _| {
            let exponents = x.to_bits().exponent_to_low() + 3 - 2;
            ((exponents & 0xff) | 0x100).low_to_exponent().as_f64s()
        });
        found.push(("narrow and widen", narrow_and_widen(simd)));
        found
    }
}

#[inline(always)]
fn narrow_and_widen<S: Lanes>(simd: S) -> [f64; N] {
    let (mut narrow, mut doubled, mut values) = ([0.0; N], [0.0; N], [0.0; N]);
    for index in 0..N / S::F64_LANES {
        F64s::load(simd, &X, index).narrow(&mut narrow, index);
    }
    for index in 0..N / S::F32_LANES {
        let x = F32s::load(simd, &narrow, index);
        ((2.0 * x + x) - x).store(&mut doubled, index);
    }
    for index in 0..N / S::F64_LANES {
        F64s::widen(simd, &doubled, index).store(&mut values, index);
    }
    values
}

/// The same with the operations of the language.
fn expected() -> Found {
    let each = |name, f: &dyn Fn(f64, f64) -> f64| (name, std::array::from_fn(|i| f(X[i], Y[i])));
    let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
    let max = |x: f64, bound: f64| if x > bound { x } else { bound };
    let min = |x: f64, bound: f64| if x < bound { x } else { bound };
    vec![
        each("add", &|x, y| x + y),
        each("sub", &|x, y| x - y),
        each("mul", &|x, y| x * y),
        each("div", &|x, y| x / y),
        each("neg", &|x, _| -x),
        each("with numbers", &|x, _| 2.0 * (x + 1.0) - (3.0 - x)),
        // The product is exact, so that it does not matter whether the sum is fused.
        each("mul_add", &|x, y| x * 4.0 + y),
        each("recip", &|x, _| x.recip()),
        each("sqrt", &|x, _| x.sqrt()),
        each("max", &max),
        each("min", &min),
        each("clamp", &|x, _| min(max(x, -1.0), 2.0)),
        each("floor", &|x, _| x.floor()),
        each("ceil", &|x, _| x.ceil()),
        each("below", &|x, y| flag(x < y)),
        each("at most", &|x, y| flag(x <= y)),
        each("equal", &|x, y| flag(x == y)),
        each("and", &|x, y| flag((x < y) & (x < 0.5))),
        each("or", &|x, y| flag((x < y) | (x < 0.5))),
        each("not", &|x, y| flag(!matches!(x.partial_cmp(&y), Some(std::cmp::Ordering::Less)))),
        each("exponents", &|x, _| {
            let exponents = (x.to_bits() >> 52).wrapping_add(1);
            f64::from_bits(((exponents & 0xff) | 0x100) << 52)
        }),
        each("narrow and widen", &|x, _| {
            let x = x as f32;
            f64::from((2.0 * x + x) - x)
        }),
    ]
}

#[test]
fn vectors_compute_as_numbers_do() {
    for isa in Isa::available() {
        let (found, expected) = (dispatch(isa, Everything), expected());
        assert_eq!(found.len(), expected.len());
        for ((name, found), (expected_name, expected)) in found.iter().zip(&expected) {
            assert_eq!(name, expected_name);
            for i in 0..N {
                let (found, expected) = (found[i], expected[i]);
                let is_same = found.to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan());
                assert!(is_same, "{isa}, {name} of {} and {}: {found}, not {expected}", X[i], Y[i]);
            }
        }
    }
}
