#![doc = include_str!("../README.md")]

pub use cpu_isa::Isa;
pub use pulp;

mod activation;
mod gemm;
pub mod lanes;
mod norm;
pub mod rows;
mod tile;
pub mod vector;

pub use activation::Activation;
pub use gemm::{Packed, Rows, multiply, multiply_transposed, multiply_with_bias, panel_columns};
pub use norm::LayerNorm;

use pulp::{Scalar, Simd, WithSimd};

/// Runs a kernel on the vectors of an instruction set.
///
/// # Panics
/// If the processor lacks it.
#[inline]
pub fn dispatch<K: WithSimd>(isa: Isa, kernel: K) -> K::Output {
    match isa {
        Isa::Scalar => Simd::vectorize(Scalar::new(), kernel),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => Simd::vectorize(pulp::x86::V3::try_new().expect("a processor with AVX2"), kernel),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => Simd::vectorize(pulp::x86::V4::try_new().expect("a processor with AVX-512"), kernel),
        #[cfg(target_arch = "aarch64")]
        Isa::Neon => Simd::vectorize(pulp::aarch64::Neon::try_new().expect("a processor with NEON"), kernel),
        #[allow(unreachable_patterns)]
        other => panic!("this processor lacks {other}"),
    }
}

/// `compiled_for!(isa, work)` is the value of the expression `work`, compiled for an instruction set whose vectors the compiler finds by
/// itself. For loops in which little time is spent, or which it turns into good code for AVX2: wider sets are not used, because what it does
/// with them is not known.
///
/// A closure is compiled for a set only where it is inlined, so this is a macro, which sees to that. Functions that `work` calls must be
/// `#[inline(always)]` for the same reason.
///
/// # Panics
/// If the processor lacks the set.
#[macro_export]
macro_rules! compiled_for {
    ($isa:expr, $work:expr $(,)?) => {
        $crate::inlined_for(
            $isa,
            #[inline(always)]
            || $work,
        )
    };
}

/// What [`compiled_for`] does with its closure, which must be `#[inline(always)]`.
#[doc(hidden)]
#[inline]
pub fn inlined_for<R>(isa: Isa, work: impl FnOnce() -> R) -> R {
    struct Work<F>(F);

    impl<R, F: FnOnce() -> R> WithSimd for Work<F> {
        type Output = R;

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> R {
            (self.0)()
        }
    }
    dispatch(isa.min(Isa::Avx2), Work(work))
}
