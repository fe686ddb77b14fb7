//! Tensors in files: of PyTorch, of which nothing is executed, or safetensors.

use crate::{Error, Result};
use candle_core::safetensors::BufferedSafetensors;
use candle_core::{DType, Device};
use std::io::Read;
use std::path::{Path, PathBuf};
use torch_file::{Dtype, Tensor, TorchFile};

pub(super) struct Source {
    path: PathBuf,
    container: Container,
}

enum Container {
    Torch(Box<TorchFile>),
    Safetensors(BufferedSafetensors),
}

/// A tensor in a file.
pub(super) struct Stored {
    pub(super) name: String,
    pub(super) shape: Vec<usize>,
    /// In a file of PyTorch.
    tensor: Option<Tensor>,
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
            let file = BufferedSafetensors::new(bytes).map_err(|source| unreadable(&source))?;
            let tensors = safetensors(path, &file)?;
            (Container::Safetensors(file), tensors)
        };
        Ok((Self { path: path.to_owned(), container }, tensors))
    }

    /// The values of a tensor in row-major order.
    pub(super) fn values(&mut self, stored: &Stored) -> Result<Vec<f32>> {
        match (&mut self.container, &stored.tensor) {
            (Container::Torch(file), Some(tensor)) => {
                let values = file.numbers(tensor).map_err(|source| unreadable(&self.path, &source))?;
                Ok(values.into_iter().map(|value| value as f32).collect())
            }
            (Container::Safetensors(file), _) => {
                let tensor = file.load(&stored.name, &Device::Cpu).and_then(|t| t.to_dtype(DType::F32));
                let values = tensor.and_then(|tensor| tensor.flatten_all()?.to_vec1());
                values.map_err(|source| unreadable(&self.path, &source))
            }
            (Container::Torch(_), None) => unreachable!("what a file of PyTorch lists has a tensor"),
        }
    }
}

fn torch_tensors(path: &Path, file: &TorchFile) -> Result<Vec<Stored>> {
    let none = || Error::WeightsNone { path: path.to_owned() };
    let state = file.state().filter(|state| !state.is_empty()).ok_or_else(none)?;
    let stored = |(name, tensor): (&str, Tensor)| {
        if !matches!(tensor.dtype(), Dtype::F32 | Dtype::F64) {
            return Err(Error::WeightsType { path: path.to_owned(), name: name.to_owned() });
        }
        let shape = tensor.shape().iter().map(|&size| size as usize).collect();
        Ok(Stored { name: name.to_owned(), shape, tensor: Some(tensor) })
    };
    state.into_iter().map(stored).collect()
}

fn safetensors(path: &Path, file: &BufferedSafetensors) -> Result<Vec<Stored>> {
    let tensors = file.tensors().into_iter().map(|(name, view)| {
        if !DType::try_from(view.dtype()).is_ok_and(|dtype| dtype.is_float()) {
            return Err(Error::WeightsType { path: path.to_owned(), name });
        }
        Ok(Stored { name, shape: view.shape().to_vec(), tensor: None })
    });
    tensors.collect()
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
