#![doc = include_str!("../README.md")]

mod kept;
mod safetensors_file;
mod weights;

#[cfg(feature = "torch")]
mod archive;
#[cfg(feature = "torch")]
mod error;
#[cfg(feature = "torch")]
mod file;
#[cfg(feature = "torch")]
mod legacy;
#[cfg(feature = "torch")]
mod pickle;
#[cfg(feature = "torch")]
mod rule;
#[cfg(feature = "torch")]
mod tensor_file;

pub use kept::{Kept, KeptFault, KeptTensor, Stored, singles, write_kept};
pub use safetensors_file::{Checked, SafetensorsFault, checked, to_bytes};
pub use weights::{WeightFault, WeightProblem, first_few};

#[cfg(feature = "torch")]
pub use error::{TorchError, TorchResult};
#[cfg(feature = "torch")]
pub use file::TorchFile;
#[cfg(feature = "torch")]
pub use pickle::{Dtype, Pickle, Tensor, Value};
#[cfg(feature = "torch")]
pub use rule::TorchRule;
#[cfg(feature = "torch")]
pub use tensor_file::{StoredTensor, TensorFile, TensorFileError};
