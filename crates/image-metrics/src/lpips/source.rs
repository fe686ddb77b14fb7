//! Tensors in files: of PyTorch, of which nothing is executed, or safetensors.

use crate::{Error, Result};
use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use torch_file::{Tensor, TorchFile};

pub(super) struct Source {
    path: PathBuf,
    container: Container,
}

enum Container {
    Torch(Box<TorchFile>),
    /// The bytes of the tensors.
    Safetensors(Vec<u8>),
}

/// A tensor in a file.
pub(super) struct Stored {
    pub(super) name: String,
    pub(super) shape: Vec<usize>,
    place: Place,
}

enum Place {
    Torch(Tensor),
    Safetensors(Dtype, Range<usize>),
}

impl Source {
    /// Opens a file, and lists what it holds.
    pub(super) fn open(path: &Path) -> Result<(Self, Vec<Stored>)> {
        let unreadable = |source: &dyn std::error::Error| unreadable(path, source);
        let mut file = std::fs::File::open(path).map_err(|source| unreadable(&source))?;
        let mut start = Vec::new();
        Read::take(&mut file, 2).read_to_end(&mut start).map_err(|source| unreadable(&source))?;
        // An archive, or a pickle of protocol 2.
        let (container, tensors) = if start == b"PK" || start == b"\x80\x02" {
            let file = TorchFile::open(path).map_err(|source| unreadable(&source))?;
            let tensors = torch_tensors(path, &file)?;
            (Container::Torch(Box::new(file)), tensors)
        } else {
            drop(file);
            let bytes = std::fs::read(path).map_err(|source| unreadable(&source))?;
            let (tensors, bytes) = safetensors(path, bytes)?;
            (Container::Safetensors(bytes), tensors)
        };
        Ok((Self { path: path.to_owned(), container }, tensors))
    }

    /// The values of a tensor in row-major order.
    pub(super) fn values(&mut self, stored: &Stored) -> Result<Vec<f32>> {
        match (&mut self.container, &stored.place) {
            (Container::Torch(file), Place::Torch(tensor)) => {
                let values = file.numbers(tensor).map_err(|source| unreadable(&self.path, &source))?;
                Ok(values.into_iter().map(|value| value as f32).collect())
            }
            (Container::Safetensors(bytes), Place::Safetensors(dtype, range)) => {
                Ok(numbers(*dtype, &bytes[range.clone()]))
            }
            _ => unreachable!("a tensor of another file"),
        }
    }
}

fn torch_tensors(path: &Path, file: &TorchFile) -> Result<Vec<Stored>> {
    let none = || Error::WeightsNone { path: path.to_owned() };
    let state = file.state().filter(|state| !state.is_empty()).ok_or_else(none)?;
    let stored = |(name, tensor): (&str, Tensor)| {
        if !matches!(tensor.dtype(), torch_file::Dtype::F32 | torch_file::Dtype::F64) {
            return Err(Error::WeightsType { path: path.to_owned(), name: name.to_owned() });
        }
        let shape = tensor.shape().iter().map(|&size| size as usize).collect();
        Ok(Stored { name: name.to_owned(), shape, place: Place::Torch(tensor) })
    };
    state.into_iter().map(stored).collect()
}

/// The tensors of a file, and the bytes in which they lie.
fn safetensors(path: &Path, mut bytes: Vec<u8>) -> Result<(Vec<Stored>, Vec<u8>)> {
    let (header, metadata) =
        SafeTensors::read_metadata(&bytes).map_err(|source| unreadable(path, &source))?;
    // Behind the header and its length.
    bytes.drain(..size_of::<u64>() + header);
    let stored = |(name, tensor): (String, &safetensors::tensor::TensorInfo)| {
        if !matches!(tensor.dtype, Dtype::F16 | Dtype::BF16 | Dtype::F32 | Dtype::F64) {
            return Err(Error::WeightsType { path: path.to_owned(), name });
        }
        let (start, end) = tensor.data_offsets;
        Ok(Stored { name, shape: tensor.shape.clone(), place: Place::Safetensors(tensor.dtype, start..end) })
    };
    Ok((metadata.tensors().into_iter().map(stored).collect::<Result<_>>()?, bytes))
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

/// With the whole chain of reasons: the error is compared and copied, which its sources are not.
fn unreadable(path: &Path, source: &dyn std::error::Error) -> Error {
    let mut reason = source.to_string();
    let mut cause = source.source();
    while let Some(source) = cause {
        reason += &format!(": {source}");
        cause = source.source();
    }
    Error::WeightsUnreadable { path: path.to_owned(), reason }
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
