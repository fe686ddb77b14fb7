//! [`Lanes`] of each instruction set.

use super::Lanes;
use pulp::Scalar;

impl Lanes for Scalar {
    #[inline(always)]
    fn widen(self, numbers: &[f32]) -> f64 {
        f64::from(numbers[0])
    }

    #[inline(always)]
    fn narrow(self, x: f64, numbers: &mut [f32]) {
        numbers[0] = x as f32;
    }

    // One instruction of SSE2; `f64::max` is several, because it tests both numbers for NaN.
    #[inline(always)]
    fn max(self, x: f64, bound: f64) -> f64 {
        if x > bound { x } else { bound }
    }

    #[inline(always)]
    fn min(self, x: f64, bound: f64) -> f64 {
        if x < bound { x } else { bound }
    }

    #[inline(always)]
    fn floor(self, x: f64) -> f64 {
        let near = nearest(x);
        if near > x { near - 1.0 } else { near }
    }

    #[inline(always)]
    fn ceil(self, x: f64) -> f64 {
        -self.floor(-x)
    }

    #[inline(always)]
    fn low_to_exponent(self, bits: u64) -> u64 {
        bits << 52
    }

    #[inline(always)]
    fn exponent_to_low(self, bits: u64) -> u64 {
        bits >> 52
    }
}

/// A nearest whole number, with the sign of x. SSE2 has no instruction for it, and `f64::floor` is a call of a function there, before which all
/// registers are stored.
#[inline(always)]
fn nearest(x: f64) -> f64 {
    // 2⁵², from which on all numbers are whole. Added to a smaller number, it leaves no room for a fraction.
    const WHOLE: f64 = 4_503_599_627_370_496.0;
    let size = x.abs();
    if size < WHOLE { ((size + WHOLE) - WHOLE).copysign(x) } else { x }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Lanes;
    use pulp::x86::{V3, V4};
    use pulp::{Simd, cast, f32x4, f32x8, f64x4, f64x8, u64x4, u64x8};

    impl Lanes for V3 {
        #[inline(always)]
        fn widen(self, numbers: &[f32]) -> f64x4 {
            let numbers: [f32; 4] = numbers.try_into().expect("four numbers");
            self.convert_f32x4_to_f64x4(cast::<[f32; 4], f32x4>(numbers))
        }

        #[inline(always)]
        fn narrow(self, x: f64x4, numbers: &mut [f32]) {
            numbers.copy_from_slice(&cast::<f32x4, [f32; 4]>(self.convert_f64x4_to_f32x4(x)));
        }

        // The instruction returns its second number if either number is NaN.
        #[inline(always)]
        fn max(self, x: f64x4, bound: f64x4) -> f64x4 {
            self.max_f64s(x, bound)
        }

        #[inline(always)]
        fn min(self, x: f64x4, bound: f64x4) -> f64x4 {
            self.min_f64s(x, bound)
        }

        #[inline(always)]
        fn floor(self, x: f64x4) -> f64x4 {
            self.floor_f64x4(x)
        }

        #[inline(always)]
        fn ceil(self, x: f64x4) -> f64x4 {
            self.ceil_f64x4(x)
        }

        #[inline(always)]
        fn low_to_exponent(self, bits: u64x4) -> u64x4 {
            self.shl_const_u64x4::<52>(bits)
        }

        #[inline(always)]
        fn exponent_to_low(self, bits: u64x4) -> u64x4 {
            self.shr_const_u64x4::<52>(bits)
        }
    }

    impl Lanes for V4 {
        #[inline(always)]
        fn widen(self, numbers: &[f32]) -> f64x8 {
            let numbers: [f32; 8] = numbers.try_into().expect("eight numbers");
            self.convert_f32x8_to_f64x8(cast::<[f32; 8], f32x8>(numbers))
        }

        #[inline(always)]
        fn narrow(self, x: f64x8, numbers: &mut [f32]) {
            numbers.copy_from_slice(&cast::<f32x8, [f32; 8]>(self.convert_f64x8_to_f32x8(x)));
        }

        // As with AVX2.
        #[inline(always)]
        fn max(self, x: f64x8, bound: f64x8) -> f64x8 {
            self.max_f64s(x, bound)
        }

        #[inline(always)]
        fn min(self, x: f64x8, bound: f64x8) -> f64x8 {
            self.min_f64s(x, bound)
        }

        // 8 suppresses exceptions; 1 rounds down, 2 rounds up.
        #[inline(always)]
        fn floor(self, x: f64x8) -> f64x8 {
            cast(self.avx512f._mm512_roundscale_pd::<{ 8 | 1 }>(cast(x)))
        }

        #[inline(always)]
        fn ceil(self, x: f64x8) -> f64x8 {
            cast(self.avx512f._mm512_roundscale_pd::<{ 8 | 2 }>(cast(x)))
        }

        #[inline(always)]
        fn low_to_exponent(self, bits: u64x8) -> u64x8 {
            self.shl_const_u64x8::<52>(bits)
        }

        #[inline(always)]
        fn exponent_to_low(self, bits: u64x8) -> u64x8 {
            self.shr_const_u64x8::<52>(bits)
        }
    }
}

/// The two lanes one by one, because pulp has no such functions for NEON.
#[cfg(target_arch = "aarch64")]
mod neon {
    use super::Lanes;
    use pulp::aarch64::Neon;
    use pulp::{f64x2, u64x2};

    #[inline(always)]
    fn each(x: f64x2, f: impl Fn(f64) -> f64) -> f64x2 {
        f64x2(f(x.0), f(x.1))
    }

    #[inline(always)]
    fn both(x: f64x2, y: f64x2, f: impl Fn(f64, f64) -> f64) -> f64x2 {
        f64x2(f(x.0, y.0), f(x.1, y.1))
    }

    impl Lanes for Neon {
        #[inline(always)]
        fn widen(self, numbers: &[f32]) -> f64x2 {
            f64x2(f64::from(numbers[0]), f64::from(numbers[1]))
        }

        #[inline(always)]
        fn narrow(self, x: f64x2, numbers: &mut [f32]) {
            numbers.copy_from_slice(&[x.0 as f32, x.1 as f32]);
        }

        // NEON's own instruction returns NaN if either number is.
        #[inline(always)]
        fn max(self, x: f64x2, bound: f64x2) -> f64x2 {
            both(
                x,
                bound,
                #[inline(always)]
                |x, bound| if x > bound { x } else { bound },
            )
        }

        #[inline(always)]
        fn min(self, x: f64x2, bound: f64x2) -> f64x2 {
            both(
                x,
                bound,
                #[inline(always)]
                |x, bound| if x < bound { x } else { bound },
            )
        }

        #[inline(always)]
        fn floor(self, x: f64x2) -> f64x2 {
            each(x, f64::floor)
        }

        #[inline(always)]
        fn ceil(self, x: f64x2) -> f64x2 {
            each(x, f64::ceil)
        }

        #[inline(always)]
        fn low_to_exponent(self, bits: u64x2) -> u64x2 {
            u64x2(bits.0 << 52, bits.1 << 52)
        }

        #[inline(always)]
        fn exponent_to_low(self, bits: u64x2) -> u64x2 {
            u64x2(bits.0 >> 52, bits.1 >> 52)
        }
    }
}
