#![doc = include_str!("../README.md")]

#[cfg(feature = "safetensors")]
mod kept;
#[cfg(feature = "safetensors")]
mod safetensors_file;
#[cfg(feature = "safetensors")]
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

#[cfg(all(feature = "safetensors", feature = "torch"))]
mod tensor_file;

#[cfg(feature = "safetensors")]
pub use kept::{Kept, KeptFault, KeptTensor, Stored, singles, write_kept};
#[cfg(feature = "safetensors")]
pub use safetensors_file::{Checked, SafetensorsFault, checked, to_bytes};
#[cfg(feature = "safetensors")]
pub use weights::{WeightFault, WeightProblem, first_few};

#[cfg(feature = "torch")]
pub use error::{TorchError, TorchResult};
#[cfg(feature = "torch")]
pub use file::TorchFile;
#[cfg(feature = "torch")]
pub use pickle::{Dtype, Pickle, Tensor, Value};
#[cfg(feature = "torch")]
pub use rule::TorchRule;

#[cfg(all(feature = "safetensors", feature = "torch"))]
pub use tensor_file::{StoredTensor, TensorFile, TensorFileError};
