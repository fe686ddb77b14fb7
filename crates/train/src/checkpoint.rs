//! A checkpoint: weights, optimiser, step. All random draws depend on seed and step alone, so this is enough to resume to
//! the same weights bit for bit.

use crate::adam::Adam;
use crate::{Config, Error, Result};
use gs_scene::write_atomically;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

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

pub(crate) fn write(path: &Path, progress: &Progress, weights: &[f32], adam: &Adam) -> Result<()> {
    let broken = |problem: String| Error::Broken { path: path.to_path_buf(), problem };
    let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let tensors =
        [("weights", bytes(weights)), ("first", bytes(&adam.first)), ("second", bytes(&adam.second))];
    let views = tensors
        .iter()
        .map(|(name, data)| Ok((*name, TensorView::new(Dtype::F32, vec![weights.len()], data)?)))
        .collect::<std::result::Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(|e| broken(e.to_string()))?;
    let progress = serde_json::to_string(progress).map_err(|e| broken(e.to_string()))?;
    let bytes = serialize(views, Some(HashMap::from([("run".to_owned(), progress)])))
        .map_err(|e| broken(e.to_string()))?;
    Ok(write_atomically(path, |out| out.write_all(&bytes))?)
}

/// A checkpoint of a run with these weights' length.
pub(crate) fn read(path: &Path, numbers: usize) -> Result<(Progress, Vec<f32>, Adam)> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    let parse = || -> std::result::Result<_, String> {
        let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|e| e.to_string())?;
        let progress = metadata.metadata().as_ref().and_then(|m| m.get("run")).ok_or("not a checkpoint")?;
        let progress: Progress = serde_json::from_str(progress).map_err(|e| e.to_string())?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| e.to_string())?;
        let values = |name: &str| -> std::result::Result<Vec<f32>, String> {
            let found = tensors.tensor(name).map_err(|e| e.to_string())?;
            let (values, rest) = found.data().as_chunks::<4>();
            if found.dtype() != Dtype::F32 || values.len() != numbers || !rest.is_empty() {
                return Err(format!(
                    "{name}: {:?} {:?}, expected {numbers} f32",
                    found.dtype(),
                    found.shape()
                ));
            }
            Ok(values.iter().map(|&v| f32::from_le_bytes(v)).collect())
        };
        let adam = Adam { first: values("first")?, second: values("second")?, updates: progress.updates };
        Ok((values("weights")?, adam, progress))
    };
    let (weights, adam, progress) =
        parse().map_err(|problem| Error::Broken { path: path.to_path_buf(), problem })?;
    Ok((progress, weights, adam))
}
