//! Errors of golden files.

use safetensors::tensor::Dtype;
use std::path::PathBuf;

/// What can be wrong with a file of golden data.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a safetensors file.
    #[error("{} is not a safetensors file", file.display())]
    Format {
        /// The file.
        file: PathBuf,
        /// Why.
        source: safetensors::SafeTensorError,
    },
    /// A tensor of the layout is not there.
    #[error("{} has no tensor {tensor}", file.display())]
    Absent {
        /// The file.
        file: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// A tensor has a type that the layout does not use.
    #[error("{}: tensor {tensor} has type {found:?}, expected F64, F32, I32 or U8", file.display())]
    Type {
        /// The file.
        file: PathBuf,
        /// The tensor.
        tensor: String,
        /// Its type.
        found: Dtype,
    },
    /// A tensor does not fit the others.
    #[error("{}: tensor {tensor} has shape {found:?}, expected {expected:?}", file.display())]
    Shape {
        /// The file.
        file: PathBuf,
        /// The tensor.
        tensor: String,
        /// The shape that follows from the layout and the other tensors.
        expected: Vec<usize>,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A number lies outside what the layout allows.
    #[error("{}: number {index} of tensor {tensor} is {found}, expected {expected}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The tensor.
        tensor: String,
        /// Index of the number in the tensor, row-major.
        index: usize,
        /// The number.
        found: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The number of SH coefficients does not belong to a degree of 0 to 3.
    #[error("{}: {found} SH coefficients per channel, expected 1, 4, 9 or 16", file.display())]
    ShCoefficients {
        /// The file.
        file: PathBuf,
        /// Coefficients found.
        found: usize,
    },
    /// The camera is not valid.
    #[error("{}: the camera of viewmat, K and size_wh is not valid", file.display())]
    Camera {
        /// The file.
        file: PathBuf,
        /// Why.
        source: gs_scene::Error,
    },
    /// The deviations of plain f32 in the metadata are not JSON.
    #[error("{}: f32_naive of the metadata is not JSON", file.display())]
    Floors {
        /// The file.
        file: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
}

/// A result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
