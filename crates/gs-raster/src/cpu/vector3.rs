//! Three-dimensional vectors of several Gaussians at once: each coordinate is a vector of numbers, one lane per Gaussian.

use cpu_kernels::lanes::{F64s, Lanes, Mask};
use cpu_kernels::pulp::Scalar;
use glam::DVec3;
use std::ops::{Add, Mul, Sub};

#[derive(Clone, Copy)]
pub(super) struct Vector3<S: Lanes> {
    pub(super) x: F64s<S>,
    pub(super) y: F64s<S>,
    pub(super) z: F64s<S>,
}

impl<S: Lanes> Vector3<S> {
    #[inline(always)]
    pub(super) fn new(x: F64s<S>, y: F64s<S>, z: F64s<S>) -> Self {
        Self { x, y, z }
    }

    /// The same three-dimensional vector in every lane.
    #[inline(always)]
    pub(super) fn splat(simd: S, v: DVec3) -> Self {
        Self { x: F64s::splat(simd, v.x), y: F64s::splat(simd, v.y), z: F64s::splat(simd, v.z) }
    }

    /// Vector number `index` of columns of coordinates.
    #[inline(always)]
    pub(super) fn load<const N: usize>(simd: S, [x, y, z]: &[[f64; N]; 3], index: usize) -> Self {
        Self { x: F64s::load(simd, x, index), y: F64s::load(simd, y, index), z: F64s::load(simd, z, index) }
    }

    #[inline(always)]
    pub(super) fn store<const N: usize>(self, [x, y, z]: &mut [[f64; N]; 3], index: usize) {
        self.x.store(x, index);
        self.y.store(y, index);
        self.z.store(z, index);
    }

    /// As [`Vector3::load`], of columns of f32.
    #[inline(always)]
    pub(super) fn widen<const N: usize>(simd: S, [x, y, z]: &[[f32; N]; 3], index: usize) -> Self {
        Self {
            x: F64s::widen(simd, x, index),
            y: F64s::widen(simd, y, index),
            z: F64s::widen(simd, z, index),
        }
    }

    #[inline(always)]
    pub(super) fn narrow<const N: usize>(self, [x, y, z]: &mut [[f32; N]; 3], index: usize) {
        self.x.narrow(x, index);
        self.y.narrow(y, index);
        self.z.narrow(z, index);
    }

    #[inline(always)]
    pub(super) fn dot(self, other: Self) -> F64s<S> {
        self.z.mul_add(other.z, self.y.mul_add(other.y, self.x * other.x))
    }

    #[inline(always)]
    pub(super) fn length_squared(self) -> F64s<S> {
        self.dot(self)
    }

    /// Without fused multiply-adds: those would leave a rounding error where two equal products cancel.
    #[inline(always)]
    pub(super) fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// self · factor + term.
    #[inline(always)]
    pub(super) fn mul_add(self, factor: F64s<S>, term: Self) -> Self {
        Self {
            x: self.x.mul_add(factor, term.x),
            y: self.y.mul_add(factor, term.y),
            z: self.z.mul_add(factor, term.z),
        }
    }

    /// The smaller of each coordinate and `bound`.
    #[inline(always)]
    pub(super) fn min(self, bound: F64s<S>) -> Self {
        Self { x: self.x.min(bound), y: self.y.min(bound), z: self.z.min(bound) }
    }

    #[inline(always)]
    pub(super) fn max_element(self) -> F64s<S> {
        self.x.max(self.y.max(self.z))
    }

    /// `yes` where the mask is set, 0 elsewhere.
    #[inline(always)]
    pub(super) fn or_zero(mask: Mask<S>, yes: Self) -> Self {
        let zero = yes.x.all(0.0);
        Self { x: mask.select(yes.x, zero), y: mask.select(yes.y, zero), z: mask.select(yes.z, zero) }
    }
}

impl Vector3<Scalar> {
    /// The one vector.
    pub(super) fn vector(self) -> DVec3 {
        DVec3::new(self.x.number(), self.y.number(), self.z.number())
    }
}

/// An operation by coordinates, with a vector or with a number.
macro_rules! operator {
    ($trait:ident, $method:ident, $(|$other:ident: $type:ty| $x:expr, $y:expr, $z:expr);*) => {
        $(impl<S: Lanes> $trait<$type> for Vector3<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, $other: $type) -> Self {
                Self {
                    x: $trait::$method(self.x, $x),
                    y: $trait::$method(self.y, $y),
                    z: $trait::$method(self.z, $z),
                }
            }
        })*
    };
}

operator!(Add, add, |other: Self| other.x, other.y, other.z);
operator!(Sub, sub, |other: Self| other.x, other.y, other.z);
operator!(Mul, mul, |other: Self| other.x, other.y, other.z; |number: F64s<S>| number, number, number);
