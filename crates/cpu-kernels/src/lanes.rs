//! Vectors of numbers with operators, so that a formula reads as it does for one number. The scalar set has vectors of one lane, so one copy
//! of the formula serves every instruction set.
//!
//! Every function here is `#[inline(always)]`, and every function and closure that a [`Kernel`] calls must be, too. Vector instructions are
//! used only in code that is inlined into the function that is compiled for them.

mod sets;

use crate::Isa;
use pulp::{Scalar, Simd, WithSimd, cast};
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

/// An instruction set of pulp, with operations that pulp has for single sets but not in its trait of all sets.
pub trait Lanes: Simd {
    /// Converts as many numbers as a vector of f64 has lanes.
    fn widen(self, numbers: &[f32]) -> Self::f64s;
    /// Rounds to f32. `numbers` are as many as a vector of f64 has lanes.
    fn narrow(self, x: Self::f64s, numbers: &mut [f32]);
    /// The larger number; `bound` where `x` is NaN.
    fn max(self, x: Self::f64s, bound: Self::f64s) -> Self::f64s;
    /// The smaller number; `bound` where `x` is NaN.
    fn min(self, x: Self::f64s, bound: Self::f64s) -> Self::f64s;
    /// The largest whole number that is not above.
    fn floor(self, x: Self::f64s) -> Self::f64s;
    /// The smallest whole number that is not below.
    fn ceil(self, x: Self::f64s) -> Self::f64s;
    /// The low 12 bits, moved to where sign and exponent are.
    fn low_to_exponent(self, bits: Self::u64s) -> Self::u64s;
    /// The bits of sign and exponent, moved to the low end.
    fn exponent_to_low(self, bits: Self::u64s) -> Self::u64s;
}

/// Work that runs on the vectors of any instruction set. pulp's `WithSimd` with the operations of [`Lanes`].
pub trait Kernel {
    /// The result.
    type Output;

    /// Does the work; must be `#[inline(always)]`.
    fn run<S: Lanes>(self, simd: S) -> Self::Output;
}

/// Runs a kernel on the vectors of an instruction set.
///
/// # Panics
/// If the processor lacks it.
#[inline]
pub fn dispatch<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
    match isa {
        Isa::Scalar => vectorize(Scalar::new(), kernel),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => vectorize(pulp::x86::V3::try_new().expect("a processor with AVX2"), kernel),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => vectorize(pulp::x86::V4::try_new().expect("a processor with AVX-512"), kernel),
        #[cfg(target_arch = "aarch64")]
        Isa::Neon => vectorize(pulp::aarch64::Neon::try_new().expect("a processor with NEON"), kernel),
        #[allow(unreachable_patterns)]
        other => panic!("this processor lacks {other}"),
    }
}

#[inline(always)]
fn vectorize<S: Lanes, K: Kernel>(simd: S, kernel: K) -> K::Output {
    /// Carries the set as a [`Lanes`]: pulp passes it on as a `Simd` only.
    struct Run<S, K>(S, K);

    impl<S: Lanes, K: Kernel> WithSimd for Run<S, K> {
        type Output = K::Output;

        #[inline(always)]
        fn with_simd<T: Simd>(self, _: T) -> K::Output {
            self.1.run(self.0)
        }
    }
    simd.vectorize(Run(simd, kernel))
}

/// A vector type with operators: name, numbers, pulp's vector, its lanes, and pulp's names of the operations.
macro_rules! vector {
    ($(#[$doc:meta])* $name:ident, $number:ty, $vector:ident, $lanes:ident, $as_simd:ident, $as_mut_simd:ident, $splat:ident, $xor:ident,
        $mul_add:ident, $($trait:ident, $method:ident, $operation:ident);*) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        pub struct $name<S: Lanes> {
            simd: S,
            value: S::$vector,
        }

        impl<S: Lanes> $name<S> {
            /// How many numbers a vector has.
            pub const LANES: usize = S::$lanes;

            /// The same number in every lane.
            #[inline(always)]
            pub fn splat(simd: S, number: $number) -> Self {
                Self { simd, value: simd.$splat(number) }
            }

            /// The same number in every lane, under the set of this vector.
            #[inline(always)]
            pub fn all(self, number: $number) -> Self {
                Self::splat(self.simd, number)
            }

            /// Vector number `index` of a column.
            ///
            /// # Panics
            /// If the column ends before it does.
            #[inline(always)]
            pub fn load(simd: S, column: &[$number], index: usize) -> Self {
                Self { simd, value: S::$as_simd(column).0[index] }
            }

            /// Writes vector number `index` of a column.
            ///
            /// # Panics
            /// If the column ends before it does.
            #[inline(always)]
            pub fn store(self, column: &mut [$number], index: usize) {
                S::$as_mut_simd(column).0[index] = self.value;
            }

            /// self · factor + term, fused where the instruction set can.
            #[inline(always)]
            pub fn mul_add(self, factor: Self, term: Self) -> Self {
                Self { value: self.simd.$mul_add(self.value, factor.value, term.value), ..self }
            }
        }

        impl<S: Lanes> Neg for $name<S> {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                Self { value: self.simd.$xor(self.value, self.simd.$splat(-0.0)), ..self }
            }
        }

        $(
            impl<S: Lanes> $trait for $name<S> {
                type Output = Self;

                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    Self { value: self.simd.$operation(self.value, other.value), ..self }
                }
            }

            impl<S: Lanes> $trait<$number> for $name<S> {
                type Output = Self;

                #[inline(always)]
                fn $method(self, other: $number) -> Self {
                    $trait::$method(self, self.all(other))
                }
            }

            impl<S: Lanes> $trait<$name<S>> for $number {
                type Output = $name<S>;

                #[inline(always)]
                fn $method(self, other: $name<S>) -> $name<S> {
                    $trait::$method(other.all(self), other)
                }
            }
        )*
    };
}

vector!(
    /// A vector of f32.
    F32s, f32, f32s, F32_LANES, as_simd_f32s, as_mut_simd_f32s, splat_f32s, xor_f32s, mul_add_e_f32s,
    Add, add, add_f32s; Sub, sub, sub_f32s; Mul, mul, mul_f32s; Div, div, div_f32s
);
vector!(
    /// A vector of f64.
    F64s, f64, f64s, F64_LANES, as_simd_f64s, as_mut_simd_f64s, splat_f64s, xor_f64s, mul_add_e_f64s,
    Add, add, add_f64s; Sub, sub, sub_f64s; Mul, mul, mul_f64s; Div, div, div_f64s
);

impl<S: Lanes> F64s<S> {
    /// Vector number `index` of a column of f32.
    ///
    /// # Panics
    /// If the column ends before it does.
    #[inline(always)]
    pub fn widen(simd: S, column: &[f32], index: usize) -> Self {
        Self { simd, value: simd.widen(&column[index * Self::LANES..][..Self::LANES]) }
    }

    /// Writes vector number `index` of a column of f32.
    ///
    /// # Panics
    /// If the column ends before it does.
    #[inline(always)]
    pub fn narrow(self, column: &mut [f32], index: usize) {
        self.simd.narrow(self.value, &mut column[index * Self::LANES..][..Self::LANES]);
    }

    /// The set of this vector.
    #[inline(always)]
    pub fn simd(self) -> S {
        self.simd
    }

    /// 1 / self.
    #[inline(always)]
    pub fn recip(self) -> Self {
        1.0 / self
    }

    /// √self.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self { value: self.simd.sqrt_f64s(self.value), ..self }
    }

    /// The larger number; `bound` where this one is NaN.
    #[inline(always)]
    pub fn max(self, bound: Self) -> Self {
        Self { value: self.simd.max(self.value, bound.value), ..self }
    }

    /// The smaller number; `bound` where this one is NaN.
    #[inline(always)]
    pub fn min(self, bound: Self) -> Self {
        Self { value: self.simd.min(self.value, bound.value), ..self }
    }

    /// Limits the numbers to a range; NaN becomes `low`.
    #[inline(always)]
    pub fn clamp(self, low: f64, high: f64) -> Self {
        self.max(self.all(low)).min(self.all(high))
    }

    /// The largest whole number that is not above.
    #[inline(always)]
    pub fn floor(self) -> Self {
        Self { value: self.simd.floor(self.value), ..self }
    }

    /// The smallest whole number that is not below.
    #[inline(always)]
    pub fn ceil(self) -> Self {
        Self { value: self.simd.ceil(self.value), ..self }
    }

    /// Where self < other.
    #[inline(always)]
    pub fn is_below(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, value: self.simd.less_than_f64s(self.value, other.value) }
    }

    /// Where self ≤ other.
    #[inline(always)]
    pub fn is_at_most(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, value: self.simd.less_than_or_equal_f64s(self.value, other.value) }
    }

    /// Where self = other; nowhere if one is NaN.
    #[inline(always)]
    pub fn equals(self, other: Self) -> Mask<S> {
        Mask { simd: self.simd, value: self.simd.equal_f64s(self.value, other.value) }
    }

    /// The bits of the numbers.
    #[inline(always)]
    pub fn to_bits(self) -> U64s<S> {
        U64s { simd: self.simd, value: cast(self.value) }
    }
}

/// A vector of integers modulo 2⁶⁴.
#[derive(Debug, Clone, Copy)]
pub struct U64s<S: Lanes> {
    simd: S,
    value: S::u64s,
}

impl<S: Lanes> U64s<S> {
    /// The same integer in every lane.
    #[inline(always)]
    pub fn splat(simd: S, number: u64) -> Self {
        Self { simd, value: simd.splat_u64s(number) }
    }

    /// Writes vector number `index` of a column.
    ///
    /// # Panics
    /// If the column ends before it does.
    #[inline(always)]
    pub fn store(self, column: &mut [u64], index: usize) {
        S::as_mut_simd_u64s(column).0[index] = self.value;
    }

    /// The numbers with these bits.
    #[inline(always)]
    pub fn as_f64s(self) -> F64s<S> {
        F64s { simd: self.simd, value: cast(self.value) }
    }

    /// The low 12 bits, moved to where sign and exponent are.
    #[inline(always)]
    pub fn low_to_exponent(self) -> Self {
        Self { value: self.simd.low_to_exponent(self.value), ..self }
    }

    /// The bits of sign and exponent, moved to the low end.
    #[inline(always)]
    pub fn exponent_to_low(self) -> Self {
        Self { value: self.simd.exponent_to_low(self.value), ..self }
    }
}

/// Which lanes a comparison of f64 holds in.
#[derive(Debug, Clone, Copy)]
pub struct Mask<S: Lanes> {
    simd: S,
    value: S::m64s,
}

impl<S: Lanes> Mask<S> {
    /// `yes` where the mask is set, `no` elsewhere.
    #[inline(always)]
    pub fn select(self, yes: F64s<S>, no: F64s<S>) -> F64s<S> {
        self.select_bits(yes.to_bits(), no.to_bits()).as_f64s()
    }

    /// As [`Mask::select`], of integers.
    #[inline(always)]
    pub fn select_bits(self, yes: U64s<S>, no: U64s<S>) -> U64s<S> {
        U64s { simd: self.simd, value: self.simd.select_u64s(self.value, yes.value, no.value) }
    }
}

impl<S: Lanes> Not for Mask<S> {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self { value: self.simd.not_m64s(self.value), ..self }
    }
}

/// An operation of two vectors of one kind, or of a vector and what is the same in every lane.
macro_rules! operator {
    ($name:ident, $trait:ident, $method:ident, $operation:ident $(, $number:ty)?) => {
        impl<S: Lanes> $trait for $name<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { value: self.simd.$operation(self.value, other.value), ..self }
            }
        }

        $(impl<S: Lanes> $trait<$number> for $name<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: $number) -> Self {
                $trait::$method(self, Self::splat(self.simd, other))
            }
        })?
    };
}

operator!(Mask, BitAnd, bitand, and_m64s);
operator!(Mask, BitOr, bitor, or_m64s);
operator!(U64s, Add, add, add_u64s, u64);
operator!(U64s, Sub, sub, sub_u64s, u64);
operator!(U64s, BitAnd, bitand, and_u64s, u64);
operator!(U64s, BitOr, bitor, or_u64s, u64);

impl F32s<Scalar> {
    /// The one number.
    #[inline(always)]
    pub fn number(self) -> f32 {
        self.value
    }
}

impl F64s<Scalar> {
    /// The one number.
    #[inline(always)]
    pub fn number(self) -> f64 {
        self.value
    }
}

impl Mask<Scalar> {
    /// Whether the comparison holds.
    #[inline(always)]
    pub fn holds(self) -> bool {
        self.value
    }
}

#[cfg(test)]
mod tests;
