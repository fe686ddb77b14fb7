#![doc = include_str!("../README.md")]

mod archive;
mod error;
mod file;
mod legacy;
mod pickle;
mod rule;

pub use error::{Error, Result};
pub use file::TorchFile;
pub use pickle::{Dtype, Pickle, Tensor, Value};
pub use rule::TorchRule;
