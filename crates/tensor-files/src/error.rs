use crate::TorchRule;
use std::path::PathBuf;

/// Why a file of PyTorch cannot be read: the system, or the file. There is no third.
#[derive(Debug, thiserror::Error)]
pub enum TorchError {
    /// The system refuses.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file breaks a rule of its format.
    #[error("{}: {rule}", path.display())]
    Torch {
        /// The file.
        path: PathBuf,
        /// The rule, with expected and found.
        rule: TorchRule,
    },
}

/// The result of reading a file of PyTorch.
pub type TorchResult<T> = Result<T, TorchError>;
