//! The program that builds the values of a file.

mod known;
mod machine;
mod value;

pub(crate) use machine::run;
pub(crate) use value::MAX_TEXT;
pub use value::{Dtype, Pickle, Tensor, Value};

/// Longest pickle that is read, bytes; some 70 of them stand for a tensor. What it builds takes up to a hundred times
/// as much memory, if somebody means harm.
pub(crate) const MAX_PICKLE: u64 = 1 << 23;
/// Most dimensions of a tensor.
pub(crate) const MAX_DIMENSIONS: usize = 8;
