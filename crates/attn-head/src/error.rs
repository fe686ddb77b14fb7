use std::ops::RangeInclusive;
use std::path::PathBuf;
use tensor_files::{SafetensorsFault, WeightProblem};

/// Why there are no outputs, or no weights.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number of the configuration is out of its range.
    #[error("{setting} is {found}, expected {} to {}", allowed.start(), allowed.end())]
    Setting {
        /// Name of the field.
        setting: &'static str,
        /// The value given.
        found: usize,
        /// What is allowed.
        allowed: RangeInclusive<usize>,
    },
    /// An input has another length than the number of anchors and the configuration ask for.
    #[error("{what}: {found} numbers, expected {expected}")]
    Length {
        /// Which input.
        what: &'static str,
        /// Numbers that the shape asks for.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// A tensor has another shape than its use asks for.
    #[cfg(feature = "candle")]
    #[error("{what} has shape {found:?}, expected {expected:?}")]
    Shape {
        /// Which tensor.
        what: &'static str,
        /// The shape that is needed.
        expected: Vec<usize>,
        /// That of the tensor given.
        found: Vec<usize>,
    },
    /// A tensor has another number of dimensions than its use asks for.
    #[cfg(feature = "candle")]
    #[error("{what} has shape {found:?}, expected {expected} dimensions")]
    Rank {
        /// Which tensor.
        what: &'static str,
        /// Dimensions that are needed.
        expected: usize,
        /// Shape of the tensor given.
        found: Vec<usize>,
    },
    /// A neighbour that does not exist.
    #[error("anchor {anchor} has neighbour {found}, expected an index below {n}")]
    Neighbour {
        /// Whose neighbour.
        anchor: usize,
        /// Its index.
        found: u32,
        /// Number of anchors.
        n: usize,
    },
    /// A cell that no anchor names.
    #[error("anchor {anchor} lies in cell {found}, expected an index below {n}")]
    Cell {
        /// Which anchor.
        anchor: usize,
        /// Its cell.
        found: u32,
        /// Number of anchors.
        n: usize,
    },
    /// Another number of neighbours than the MLP's input has places for.
    #[error("{found} neighbours per anchor: this head is an MLP over exactly {expected}")]
    NeighboursFixed {
        /// The number that the head is made for.
        expected: usize,
        /// The number given.
        found: usize,
    },
    /// An input is NaN or infinite.
    #[error("{what} of anchor {anchor} is not finite")]
    InputNotFinite {
        /// Which input.
        what: &'static str,
        /// Whose.
        anchor: usize,
    },
    /// Inputs and weights are finite, and so large that the result is not.
    #[error("the outputs of anchor {anchor} overflow: its inputs or the weights are extreme")]
    OutputNotFinite {
        /// Whose.
        anchor: usize,
    },
    /// Tensors of a set of weights are missing, unexpected, misshapen, of another type or not finite.
    #[error("the weights do not fit: {}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Weights {
        /// All that does not fit.
        problems: Vec<WeightProblem>,
    },
    /// The bytes are not safetensors.
    #[error("not a sound safetensors file")]
    NotSafetensors(#[from] SafetensorsFault),
    /// The metadata of the safetensors has no configuration of a head.
    #[error("no `{key}` in the file's metadata: these are not the weights of a head")]
    NotAHead {
        /// The key under which it should be.
        key: &'static str,
    },
    /// The configuration in the metadata cannot be understood.
    #[error("the file's configuration cannot be understood")]
    Description(#[source] serde_json::Error),
    /// A file is larger than the weights of any head.
    #[error("more than {limit} bytes, and no head has that many")]
    TooLarge {
        /// Largest number of bytes.
        limit: u64,
    },
    /// A file cannot be read.
    #[error("cannot be read")]
    Io(#[from] std::io::Error),
    /// What is wrong with a file.
    #[error("weights {}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<Error>,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] gs_scene::Error),
    /// An operation on tensors failed.
    #[cfg(feature = "candle")]
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
