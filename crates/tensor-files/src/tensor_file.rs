//! Floating-point tensors by name, in either format.

use crate::{SafetensorsFault, Tensor, TorchError, TorchFile, checked};
use half::{bf16, f16};
use safetensors::Dtype;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Why a file of tensors cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TensorFileError {
    /// The system refuses.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// A file of PyTorch that breaks a rule.
    #[error(transparent)]
    Torch(#[from] TorchError),
    /// A file that is neither PyTorch's nor safetensors.
    #[error(transparent)]
    Safetensors(#[from] SafetensorsFault),
    /// A file of PyTorch without tensors by name.
    #[error("no state dictionary, expected tensors by name")]
    NoTensors,
    /// A tensor of whole numbers.
    #[error("tensor {name} is of another type, expected floating-point numbers")]
    Type {
        /// The tensor.
        name: String,
    },
}

/// A file of floating-point tensors by name: of PyTorch, of which nothing is executed, or safetensors.
pub struct TensorFile {
    path: PathBuf,
    container: Container,
}

enum Container {
    Torch(Box<TorchFile>),
    /// The bytes of the tensors.
    Safetensors(Vec<u8>),
}

/// A tensor in a file.
#[derive(Debug, Clone)]
pub struct StoredTensor {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    place: Place,
}

#[derive(Debug, Clone)]
enum Place {
    Torch(Tensor),
    Safetensors(Dtype, Range<usize>),
}

impl TensorFile {
    /// Opens a file, and lists what it holds.
    ///
    /// # Errors
    /// If it cannot be read, is neither PyTorch's nor safetensors, or holds tensors of whole numbers.
    pub fn open(path: &Path) -> Result<(Self, Vec<StoredTensor>), TensorFileError> {
        let mut file = std::fs::File::open(path)?;
        let mut start = Vec::new();
        Read::take(&mut file, 2).read_to_end(&mut start)?;
        // An archive, or a pickle of protocol 2.
        let (container, tensors) = if start == b"PK" || start == b"\x80\x02" {
            let file = TorchFile::open(path)?;
            let tensors = torch_tensors(&file)?;
            (Container::Torch(Box::new(file)), tensors)
        } else {
            drop(file);
            let (tensors, bytes) = safetensors(std::fs::read(path)?)?;
            (Container::Safetensors(bytes), tensors)
        };
        Ok((Self { path: path.to_owned(), container }, tensors))
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The values of a tensor of this file in row-major order.
    ///
    /// # Errors
    /// If they are cut off or damaged, or cannot be read.
    ///
    /// # Panics
    /// If the tensor is one of a file of the other format.
    pub fn values(&mut self, stored: &StoredTensor) -> Result<Vec<f32>, TensorFileError> {
        match (&mut self.container, &stored.place) {
            (Container::Torch(file), Place::Torch(tensor)) => {
                Ok(file.numbers(tensor)?.into_iter().map(|value| value as f32).collect())
            }
            (Container::Safetensors(bytes), Place::Safetensors(dtype, range)) => {
                Ok(numbers(*dtype, &bytes[range.clone()]))
            }
            _ => unreachable!("a tensor of another file"),
        }
    }
}

fn torch_tensors(file: &TorchFile) -> Result<Vec<StoredTensor>, TensorFileError> {
    use crate::Dtype::{BF16, F16, F32, F64};
    let state = file.state().filter(|state| !state.is_empty()).ok_or(TensorFileError::NoTensors)?;
    let stored = |(name, tensor): (&str, Tensor)| {
        if !matches!(tensor.dtype(), F16 | BF16 | F32 | F64) {
            return Err(TensorFileError::Type { name: name.to_owned() });
        }
        let shape = tensor.shape().iter().map(|&size| size as usize).collect();
        Ok(StoredTensor { name: name.to_owned(), shape, place: Place::Torch(tensor) })
    };
    state.into_iter().map(stored).collect()
}

/// The tensors of a file, and the bytes in which they lie.
fn safetensors(mut bytes: Vec<u8>) -> Result<(Vec<StoredTensor>, Vec<u8>), TensorFileError> {
    let (start, metadata) = {
        let file = checked(&bytes)?;
        (file.start, file.metadata)
    };
    bytes.drain(..start);
    let stored = |(name, tensor): (String, &safetensors::tensor::TensorInfo)| {
        if !matches!(tensor.dtype, Dtype::F16 | Dtype::BF16 | Dtype::F32 | Dtype::F64) {
            return Err(TensorFileError::Type { name });
        }
        let (start, end) = tensor.data_offsets;
        let place = Place::Safetensors(tensor.dtype, start..end);
        Ok(StoredTensor { name, shape: tensor.shape.clone(), place })
    };
    Ok((metadata.tensors().into_iter().map(stored).collect::<Result<_, _>>()?, bytes))
}

/// The numbers of a tensor of safetensors, which are little-endian.
fn numbers(dtype: Dtype, bytes: &[u8]) -> Vec<f32> {
    match dtype {
        Dtype::F16 => bytes.as_chunks().0.iter().map(|bytes| f16::from_le_bytes(*bytes).to_f32()).collect(),
        Dtype::BF16 => bytes.as_chunks().0.iter().map(|bytes| bf16::from_le_bytes(*bytes).to_f32()).collect(),
        Dtype::F32 => bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(),
        Dtype::F64 => bytes.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes) as f32).collect(),
        other => unreachable!("{other:?} was refused when the file was opened"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_type_are_read() {
        assert_eq!(numbers(Dtype::F16, &[0x00, 0xbe, 0x00, 0x3c]), [-1.5, 1.0]);
        assert_eq!(numbers(Dtype::BF16, &[0xc0, 0xbf, 0x80, 0x3f]), [-1.5, 1.0]);
        assert_eq!(numbers(Dtype::F32, &(-1.5_f32).to_le_bytes()), [-1.5]);
        assert_eq!(numbers(Dtype::F64, &0.1_f64.to_le_bytes()), [0.1]);
    }
}
