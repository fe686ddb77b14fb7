//! Checkpoints: PyTorch's zip archives of pickles, of which nothing is executed, and safetensors.

use super::params::{Params, Source};
use super::variant::Variant;
use crate::{Error, Result};
use candle_core::pickle::PthTensors;
use candle_core::safetensors::BufferedSafetensors;
use candle_core::{DType, Device, Tensor};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::io::Read;
use std::path::Path;
use tensor_files::{WeightFault, WeightProblem};

/// What a dictionary of tensors may lie under in a pickle, besides lying there by itself.
const KEYS: [Option<&str>; 3] = [None, Some("state_dict"), Some("model")];
/// The depth network's names start with it, but for checkpoints of depth alone.
const PREDICTOR: &str = "depth_predictor.";
/// Other parts of training programs, and what DINOv2's files have besides.
const IGNORED: [&str; 3] = ["decoder.", "losses.", "depth_predictor.pretrained.mask_token"];
enum Archive {
    Pickle(PthTensors),
    Safetensors(BufferedSafetensors),
}

struct Entry {
    /// Its name in the file.
    stored: String,
    shape: Vec<usize>,
}

/// Tensors of a file by the names of the GS checkpoints, without `encoder.`.
struct Tensors {
    archive: Archive,
    entries: BTreeMap<String, Entry>,
}

impl Source for Tensors {
    fn names(&self) -> Vec<String> {
        self.entries.keys().cloned().collect()
    }

    fn shape(&self, name: &str) -> Option<Vec<usize>> {
        Some(self.entries.get(name)?.shape.clone())
    }

    fn load(&self, name: &str) -> candle_core::Result<Tensor> {
        let stored = self.entries.get(name).map_or(name, |entry| &entry.stored);
        let missing = || candle_core::Error::CannotFindTensor { path: stored.to_owned() };
        match &self.archive {
            Archive::Pickle(pickle) => pickle.get(stored)?.ok_or_else(missing),
            Archive::Safetensors(file) => file.load(stored, &Device::Cpu),
        }
    }
}

/// A file of weights. What is wrong with them shows when they have been asked for: [`check`].
pub(super) struct Opened {
    pub(super) params: Params,
    pub(super) variant: Variant,
    /// Whether it has weights for features and Gaussians.
    pub(super) with_heads: bool,
    /// First eight hexadecimal digits of the file's SHA-256.
    pub(super) sha256_start: String,
}

/// Parameters of the network in a file, and which network it is.
pub(super) fn open(path: &Path, device: &Device) -> Result<Opened> {
    let unreadable = |source| Error::WeightsUnreadable { path: path.to_owned(), source };
    let mut file = std::fs::File::open(path).map_err(|e| unreadable(e.into()))?;
    let mut start = [0; 4];
    file.read_exact(&mut start).map_err(|e| unreadable(e.into()))?;
    let sha256_start = checked_hash(path)?;
    let tensors = if &start == b"PK\x03\x04" { read_pickle(path) } else { read_safetensors(path) };
    let tensors = tensors.map_err(unreadable)?;
    let shape = |name: &str| tensors.shape(name);
    let variant = Variant::detect(shape)
        .ok_or_else(|| Error::WeightsUnknown { path: path.to_owned(), found: tensors.entries.len() })?;
    let with_heads = tensors.entries.keys().any(|name| !name.starts_with(PREDICTOR));
    Ok(Opened { params: Params::from_source(Box::new(tensors), device), variant, with_heads, sha256_start })
}

/// That all of a file fits, after the network has asked for what it needs.
pub(super) fn check(path: &Path, params: &Params, variant: Variant) -> Result<()> {
    let mut problems = params.problems();
    let requested: BTreeSet<String> = params.requested().into_keys().collect();
    for name in params.stored() {
        if !requested.contains(&name) {
            problems.push(WeightProblem { name, fault: WeightFault::Unexpected });
        }
    }
    if problems.is_empty() {
        return Ok(());
    }
    Err(Error::Weights { path: path.to_owned(), variant, problems })
}

/// The first eight digits of a file's hash; the published ones end in theirs: `-cfeab6b1.pth`.
fn checked_hash(path: &Path) -> Result<String> {
    let unreadable = |e: std::io::Error| Error::WeightsUnreadable { path: path.to_owned(), source: e.into() };
    let mut file = std::fs::File::open(path).map_err(unreadable)?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer).map_err(unreadable)? {
            0 => break,
            n => hash.update(&buffer[..n]),
        }
    }
    let mut found = String::new();
    for byte in &hash.finalize()[..4] {
        // Writing to a string does not fail.
        let _ = write!(found, "{byte:02x}");
    }
    let hexadecimal = |c: char| c.is_ascii_digit() || ('a'..='f').contains(&c);
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let promised = stem.rsplit_once('-').map(|(_, digits)| digits);
    match promised.filter(|digits| digits.len() == 8 && digits.chars().all(hexadecimal)) {
        Some(digits) if digits != found => {
            Err(Error::WeightsHash { path: path.to_owned(), expected: digits.to_owned(), found })
        }
        _ => Ok(found),
    }
}

fn read_pickle(path: &Path) -> candle_core::Result<Tensors> {
    for key in KEYS {
        // Candle's reader takes arguments for granted, and panics where a file lacks them.
        let read = std::panic::catch_unwind(|| PthTensors::new(path, key))
            .unwrap_or_else(|_| Err(candle_core::Error::Msg("a pickle of no meaning".to_owned())));
        let pickle = match read {
            Ok(pickle) => pickle,
            // The other keys fail where nothing has that name.
            Err(_) if key.is_some() => continue,
            Err(error) => return Err(error),
        };
        let infos = pickle.tensor_infos();
        if !infos.is_empty() {
            let shapes = infos
                .iter()
                .map(|(name, info)| (name.clone(), info.layout.shape().dims().to_vec(), info.dtype));
            let entries = entries(shapes.collect())?;
            return Ok(Tensors { archive: Archive::Pickle(pickle), entries });
        }
    }
    candle_core::bail!("no tensors in the archive, neither by themselves nor under `state_dict` or `model`")
}

fn read_safetensors(path: &Path) -> candle_core::Result<Tensors> {
    let file = BufferedSafetensors::new(std::fs::read(path)?)?;
    let shapes = file
        .tensors()
        .into_iter()
        .map(|(name, view)| Ok((name, view.shape().to_vec(), DType::try_from(view.dtype())?)))
        .collect::<candle_core::Result<_>>()?;
    let entries = entries(shapes)?;
    Ok(Tensors { archive: Archive::Safetensors(file), entries })
}

/// Tensors by the names that the network uses.
fn entries(shapes: Vec<(String, Vec<usize>, DType)>) -> candle_core::Result<BTreeMap<String, Entry>> {
    let names = |stored: &str| stored.strip_prefix("encoder.").unwrap_or(stored).to_owned();
    let whole = shapes.iter().any(|(stored, ..)| names(stored).starts_with(PREDICTOR));
    let mut entries = BTreeMap::new();
    for (stored, shape, dtype) in shapes {
        let name = if whole { names(&stored) } else { format!("{PREDICTOR}{stored}") };
        if IGNORED.iter().any(|start| name.starts_with(start)) {
            continue;
        }
        if !dtype.is_float() {
            candle_core::bail!("tensor {stored} holds {dtype:?}, expected floating-point numbers");
        }
        if let Some(other) = entries.insert(name, Entry { stored: stored.clone(), shape }) {
            candle_core::bail!("tensors {} and {stored} are one and the same", other.stored);
        }
    }
    Ok(entries)
}

#[cfg(test)]
mod tests;
