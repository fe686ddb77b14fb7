#![doc = include_str!("../README.md")]

pub use cpu_isa::Isa;
pub use pulp;

mod activation;
mod gemm;
mod norm;
pub mod rows;
mod tile;
pub mod vector;

pub use activation::Activation;
pub use gemm::{Packed, Rows, multiply, multiply_transposed, panel_columns};
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
