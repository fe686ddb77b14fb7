//! A checkpoint: weights, optimiser, step. All random draws depend on seed and step alone, so this is enough to resume to
//! the same weights bit for bit.

use crate::adam::Adam;
use crate::{Config, Error, Result};
use safetensors::tensor::Dtype;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;
use tensor_files::{Kept, KeptFault, singles, write_kept};

/// What does not fit a tensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Progress {
    pub(crate) config: Config,
    /// SHA-256 of the data.
    pub(crate) data: String,
    /// What the structural term of the loss is.
    pub(crate) structure: String,
    /// What the pictures are rendered on: others round otherwise.
    pub(crate) device: String,
    /// Steps done.
    pub(crate) step: usize,
    /// Of those, skipped.
    pub(crate) skipped: usize,
    pub(crate) updates: usize,
}

/// What the file of a head's run is.
pub(crate) const KIND: &str = "run";

/// Writes the checkpoint of a run of this kind.
pub(crate) fn write(
    path: &Path,
    kind: &'static str,
    progress: &impl Serialize,
    weights: &[f32],
    adam: &Adam,
) -> Result<()> {
    let tensor = |name: &str, values: &[f32]| {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        (name.to_owned(), Dtype::F32, vec![values.len()], bytes)
    };
    let tensors = [tensor("weights", weights), tensor("first", &adam.first), tensor("second", &adam.second)];
    write_kept(path, kind, progress, &tensors)
        .map_err(|source| Error::Checkpoint { path: path.to_path_buf(), source })
}

/// Differs, all but certainly, where what a checkpoint would hold differs.
pub(crate) fn digest(progress: &Progress, weights: &[f32], adam: &Adam) -> u64 {
    let mut hash = Sha256::new();
    hash.update(format!("{progress:?}"));
    for values in [weights, &adam.first, &adam.second] {
        values.iter().for_each(|value| hash.update(value.to_le_bytes()));
    }
    hash.finalize().first_chunk().map_or(0, |start| u64::from_le_bytes(*start))
}

/// A checkpoint of a run of this kind with so many weights; `updates` says how many the optimiser has done.
pub(crate) fn read<P: DeserializeOwned>(
    path: &Path,
    kind: &'static str,
    numbers: usize,
    updates: impl Fn(&P) -> usize,
) -> Result<(P, Vec<f32>, Adam)> {
    let read = || {
        let (progress, kept): (P, Kept) = Kept::read(path, kind)?;
        let values = |name: &str| Ok::<_, KeptFault>(singles(kept.expect(name, Dtype::F32, &[numbers])?));
        let adam = Adam { first: values("first")?, second: values("second")?, updates: updates(&progress) };
        Ok((values("weights")?, adam, progress))
    };
    let (weights, adam, progress) =
        read().map_err(|source| Error::Checkpoint { path: path.to_path_buf(), source })?;
    Ok((progress, weights, adam))
}
