//! The numbers that the filters run in, several at a time.

use std::ops::{Add, Div, Mul, Sub};

/// f32 for the loss, f64 for the measure.
pub(super) trait Real: Copy + Default + Send + Sync {
    /// A number whose square is infinite.
    const HUGE: Self;
    const INFINITY: Self;
    /// The nearest number.
    fn nearest(value: f64) -> Self;
    /// Exactly.
    fn widen(self) -> f64;
}

impl Real for f32 {
    const HUGE: Self = 1e20;
    const INFINITY: Self = Self::INFINITY;
    #[inline(always)]
    fn nearest(value: f64) -> Self {
        value as Self
    }
    #[inline(always)]
    fn widen(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    const HUGE: Self = 1e160;
    const INFINITY: Self = Self::INFINITY;
    #[inline(always)]
    fn nearest(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn widen(self) -> f64 {
        self
    }
}

/// A few numbers that are computed with at once. Everything is inlined into the function that is compiled for the
/// instruction set.
pub(super) trait Vector:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    type Real: Real;
    const LANES: usize;
    /// The number nearest to `value` in each lane.
    fn splat(value: f64) -> Self;
    /// Those from `start` on.
    fn load(values: &[Self::Real], start: usize) -> Self;
    /// To the places from `start` on.
    fn store(self, values: &mut [Self::Real], start: usize);
    /// The values of a picture from `start` on.
    fn of_picture(picture: &[f32], start: usize) -> Self;
    /// The nearest values of a picture, to the places from `start` on.
    fn to_picture(self, picture: &mut [f32], start: usize);
    /// self · factor + addend, fused where the instruction set can (elsewhere a fused one would be a library call).
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// The larger one of two.
    fn max(self, other: Self) -> Self;

    /// The sum of the lanes, in their order.
    #[inline(always)]
    fn sum(self) -> f64 {
        let mut lanes = [Self::Real::default(); 16];
        self.store(&mut lanes, 0);
        lanes[..Self::LANES].iter().map(|lane| lane.widen()).sum()
    }
}

/// Two vectors at a time, where one would wait for its own results.
#[derive(Clone, Copy)]
pub(super) struct Twice<V>(V, V);

macro_rules! twice {
    ($($operator:ident $name:ident $sign:tt),*) => {
        $(impl<V: Vector> $operator for Twice<V> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(self.0 $sign other.0, self.1 $sign other.1)
            }
        })*
    };
}
twice!(Add add +, Sub sub -, Mul mul *, Div div /);

impl<V: Vector> Vector for Twice<V> {
    type Real = V::Real;
    const LANES: usize = 2 * V::LANES;
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self(V::splat(value), V::splat(value))
    }
    #[inline(always)]
    fn load(values: &[V::Real], start: usize) -> Self {
        let values = &values[start..start + Self::LANES];
        Self(V::load(values, 0), V::load(values, V::LANES))
    }
    #[inline(always)]
    fn store(self, values: &mut [V::Real], start: usize) {
        let values = &mut values[start..start + Self::LANES];
        self.0.store(values, 0);
        self.1.store(values, V::LANES);
    }
    #[inline(always)]
    fn of_picture(picture: &[f32], start: usize) -> Self {
        Self(V::of_picture(picture, start), V::of_picture(picture, start + V::LANES))
    }
    #[inline(always)]
    fn to_picture(self, picture: &mut [f32], start: usize) {
        self.0.to_picture(picture, start);
        self.1.to_picture(picture, start + V::LANES);
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(self.0.mul_add(factor.0, addend.0), self.1.mul_add(factor.1, addend.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
    }
}

/// Vectors of any processor, as the compiler makes them from loops.
#[derive(Clone, Copy)]
pub(super) struct Portable<T, const N: usize>([T; N]);

macro_rules! portable {
    ($float:ident, $lanes:literal, $($operator:ident $name:ident $sign:tt),*) => {
        $(impl $operator for Portable<$float, $lanes> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(std::array::from_fn(|lane| self.0[lane] $sign other.0[lane]))
            }
        })*

        impl Vector for Portable<$float, $lanes> {
            type Real = $float;
            const LANES: usize = $lanes;
            #[inline(always)]
            fn splat(value: f64) -> Self {
                Self([$float::nearest(value); $lanes])
            }
            #[inline(always)]
            fn load(values: &[$float], start: usize) -> Self {
                let mut lanes = [0.0; $lanes];
                lanes.copy_from_slice(&values[start..start + $lanes]);
                Self(lanes)
            }
            #[inline(always)]
            fn store(self, values: &mut [$float], start: usize) {
                values[start..start + $lanes].copy_from_slice(&self.0);
            }
            #[inline(always)]
            fn of_picture(picture: &[f32], start: usize) -> Self {
                let picture = &picture[start..start + $lanes];
                Self(std::array::from_fn(|lane| $float::from(picture[lane])))
            }
            #[inline(always)]
            fn to_picture(self, picture: &mut [f32], start: usize) {
                picture[start..start + $lanes].copy_from_slice(&self.0.map(|value| value as f32));
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, addend: Self) -> Self {
                if cfg!(target_arch = "aarch64") {
                    let fused = |lane: usize| self.0[lane].mul_add(factor.0[lane], addend.0[lane]);
                    Self(std::array::from_fn(fused))
                } else {
                    self * factor + addend
                }
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                let larger = |lane: usize| if self.0[lane] > other.0[lane] { self.0[lane] } else { other.0[lane] };
                Self(std::array::from_fn(larger))
            }
        }
    };
}
portable!(f32, 4, Add add +, Sub sub -, Mul mul *, Div div /);
portable!(f64, 2, Add add +, Sub sub -, Mul mul *, Div div /);
