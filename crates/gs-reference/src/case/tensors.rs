//! The tensors of a file, checked.

use crate::{Error, Result};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::path::{Path, PathBuf};

/// The tensors of a file, as numbers; errors name file and tensor.
pub(super) struct Tensors<'a> {
    file: &'a Path,
    tensors: SafeTensors<'a>,
    /// `f32_naive` of the metadata, the deviations of plain f32: an object, or null.
    floors: serde_json::Value,
}

impl<'a> Tensors<'a> {
    pub(super) fn new(file: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let format = |source| Error::Format { file: file.into(), source };
        let tensors = SafeTensors::deserialize(bytes).map_err(format)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(format)?;
        // JSON in a string of the header's JSON.
        let floors = match header.metadata().as_ref().and_then(|metadata| metadata.get("f32_naive")) {
            Some(text) => {
                serde_json::from_str(text).map_err(|source| Error::Floors { file: file.into(), source })?
            }
            None => serde_json::Value::Null,
        };
        Ok(Self { file, tensors, floors })
    }

    pub(super) fn file(&self) -> PathBuf {
        self.file.into()
    }

    /// The deviation of plain f32 in one output, if the file tells it.
    pub(super) fn floor(&self, output: &str) -> Option<f64> {
        self.floors.get(output)?.as_f64()
    }

    /// A dimension of a tensor, 0 if it has not as many.
    pub(super) fn dimension(&self, tensor: &str, dimension: usize) -> Result<usize> {
        Ok(self.tensor(tensor)?.shape().get(dimension).copied().unwrap_or(0))
    }

    /// The values of a tensor, row-major.
    pub(super) fn numbers(&self, tensor: &str, shape: &[usize]) -> Result<Vec<f64>> {
        fn each<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            bytes.chunks_exact(N).map(|b| value(b.try_into().expect("N bytes"))).collect()
        }
        let view = self.tensor(tensor)?;
        if view.shape() != shape {
            return Err(Error::Shape {
                file: self.file(),
                tensor: tensor.into(),
                expected: shape.into(),
                found: view.shape().into(),
            });
        }
        let bytes = view.data();
        match view.dtype() {
            Dtype::F64 => Ok(each(bytes, f64::from_le_bytes)),
            Dtype::F32 => Ok(each(bytes, |b| f64::from(f32::from_le_bytes(b)))),
            Dtype::I32 => Ok(each(bytes, |b| f64::from(i32::from_le_bytes(b)))),
            Dtype::U8 => Ok(each(bytes, |[b]| f64::from(b))),
            found => Err(Error::Type { file: self.file(), tensor: tensor.into(), found }),
        }
    }

    /// As [`Tensors::numbers`], of a tensor that holds f32.
    pub(super) fn singles(&self, tensor: &str, shape: &[usize]) -> Result<Vec<f32>> {
        Ok(self.numbers(tensor, shape)?.into_iter().map(|value| value as f32).collect())
    }

    /// As [`Tensors::numbers`], of a tensor that holds whole numbers.
    pub(super) fn integers(&self, tensor: &str, shape: &[usize]) -> Result<Vec<i32>> {
        Ok(self.numbers(tensor, shape)?.into_iter().map(|value| value as i32).collect())
    }

    fn tensor(&self, tensor: &str) -> Result<TensorView<'a>> {
        self.tensors.tensor(tensor).map_err(|_| Error::Absent { file: self.file(), tensor: tensor.into() })
    }
}
