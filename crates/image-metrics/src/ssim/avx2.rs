//! Vectors of 256 bits. Their operations may only be inlined into functions that are compiled for AVX2 and FMA, and
//! these may only be called where [`available`] is true: both is so for the functions in this module, and nothing
//! else names the two types.
#![allow(unsafe_code)] // Intrinsics, and calls of functions that are compiled for AVX2.

use super::band::{Band, Pair, Scratch, band, statistics};
use super::vector::Vector;
use cpu_isa::Isa;
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// Whether the instructions are in use.
pub(super) fn available() -> bool {
    Isa::in_use() >= Isa::Avx2
}

#[derive(Clone, Copy)]
struct F32x8(__m256);

#[derive(Clone, Copy)]
struct F64x4(__m256d);

macro_rules! operators {
    ($vector:ident, $($operator:ident $name:ident $intrinsic:ident),*) => {
        $(impl $operator for $vector {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: the processor has AVX2, see the module.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        })*
    };
}
operators!(F32x8, Add add _mm256_add_ps, Sub sub _mm256_sub_ps, Mul mul _mm256_mul_ps, Div div _mm256_div_ps);
operators!(F64x4, Add add _mm256_add_pd, Sub sub _mm256_sub_pd, Mul mul _mm256_mul_pd, Div div _mm256_div_pd);

impl Vector for F32x8 {
    type Real = f32;
    const LANES: usize = 8;
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: the processor has AVX2, see the module.
        Self(unsafe { _mm256_set1_ps(value as f32) })
    }
    #[inline(always)]
    fn load(values: &[f32], start: usize) -> Self {
        let values = &values[start..start + 8];
        // SAFETY: there are eight values; AVX2 as above.
        Self(unsafe { _mm256_loadu_ps(values.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, values: &mut [f32], start: usize) {
        let values = &mut values[start..start + 8];
        // SAFETY: there is room for eight values; AVX2 as above.
        unsafe { _mm256_storeu_ps(values.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn of_picture(picture: &[f32], start: usize) -> Self {
        Self::load(picture, start)
    }
    #[inline(always)]
    fn to_picture(self, picture: &mut [f32], start: usize) {
        self.store(picture, start);
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: the processor has FMA, see the module.
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module.
        Self(unsafe { _mm256_max_ps(self.0, other.0) })
    }
}

impl Vector for F64x4 {
    type Real = f64;
    const LANES: usize = 4;
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: the processor has AVX2, see the module.
        Self(unsafe { _mm256_set1_pd(value) })
    }
    #[inline(always)]
    fn load(values: &[f64], start: usize) -> Self {
        let values = &values[start..start + 4];
        // SAFETY: there are four values; AVX2 as above.
        Self(unsafe { _mm256_loadu_pd(values.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, values: &mut [f64], start: usize) {
        let values = &mut values[start..start + 4];
        // SAFETY: there is room for four values; AVX2 as above.
        unsafe { _mm256_storeu_pd(values.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn of_picture(picture: &[f32], start: usize) -> Self {
        let picture = &picture[start..start + 4];
        // SAFETY: there are four values; AVX2 as above.
        Self(unsafe { _mm256_cvtps_pd(_mm_loadu_ps(picture.as_ptr())) })
    }
    #[inline(always)]
    fn to_picture(self, picture: &mut [f32], start: usize) {
        let picture = &mut picture[start..start + 4];
        // SAFETY: there is room for four values; AVX2 as above.
        unsafe { _mm_storeu_ps(picture.as_mut_ptr(), _mm256_cvtpd_ps(self.0)) }
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: the processor has FMA, see the module.
        Self(unsafe { _mm256_fmadd_pd(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module.
        Self(unsafe { _mm256_max_pd(self.0, other.0) })
    }
}

/// [`band`] in f32.
pub(super) fn band_f32(work: Band<f32>, sums: &mut [f64], gradient: &mut [f32], scratch: &mut Scratch<f32>) {
    // SAFETY: it is available, or there is a panic.
    unsafe { compiled_band::<F32x8>(checked(work), sums, gradient, scratch) }
}

/// [`band`] in f64.
pub(super) fn band_f64(work: Band<f64>, sums: &mut [f64], gradient: &mut [f32], scratch: &mut Scratch<f64>) {
    // SAFETY: it is available, or there is a panic.
    unsafe { compiled_band::<F64x4>(checked(work), sums, gradient, scratch) }
}

/// [`statistics`] in f64.
pub(super) fn statistics_f64(
    pair: Pair,
    y: usize,
    means: &mut [f64],
    contrasts: &mut [f64],
    scratch: &mut Scratch<f64>,
) {
    // SAFETY: it is available, or there is a panic.
    unsafe { compiled_statistics(checked(pair), y, means, contrasts, scratch) }
}

fn checked<T>(work: T) -> T {
    assert!(available(), "called without AVX2 and FMA");
    work
}

#[target_feature(enable = "avx2,fma")]
fn compiled_band<V: Vector>(
    work: Band<V::Real>,
    sums: &mut [f64],
    gradient: &mut [f32],
    scratch: &mut Scratch<V::Real>,
) {
    band::<V>(work, sums, gradient, scratch);
}

#[target_feature(enable = "avx2,fma")]
fn compiled_statistics(
    pair: Pair,
    y: usize,
    means: &mut [f64],
    contrasts: &mut [f64],
    scratch: &mut Scratch<f64>,
) {
    statistics::<F64x4>(pair, y, means, contrasts, scratch);
}
