//! Weights in files: safetensors with one tensor per parameter. All of the metadata stands under one key, as JSON, so
//! that the same weights give the same bytes: the order of several keys would be arbitrary.

use crate::{Config, Error, Layout, Result, WeightFault, WeightProblem, Weights};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use tensor_files::{Checked, checked, to_bytes};

/// Key of the description in the metadata.
const KEY: &str = "attn-head";
/// Largest file, bytes: above what any head within the ranges of [`Config`] needs.
const LARGEST_FILE: u64 = 64 << 20;

/// Longest header that is looked at for the description, bytes: those of heads have some thousand.
const LARGEST_HEADER: u64 = 1 << 20;

/// What is under [`KEY`].
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    config: Config,
    metadata: BTreeMap<String, String>,
}

/// What a safetensors file says of itself; of tensors nothing.
#[derive(Deserialize)]
struct Header {
    #[serde(rename = "__metadata__", default)]
    metadata: BTreeMap<String, String>,
}

impl Weights {
    /// Reads a file that [`Weights::write`] has written.
    ///
    /// # Errors
    /// If it cannot be read, is no such file, or its tensors do not fit its configuration; all that do not are named.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let read = || {
            let mut bytes = Vec::new();
            File::open(path)?.take(LARGEST_FILE + 1).read_to_end(&mut bytes)?;
            Self::from_bytes(&bytes)
        };
        read().map_err(|error| Error::File { path: path.to_owned(), source: Box::new(error) })
    }

    /// Whether a file is of this kind, by its description; what else is wrong with it, reading tells.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn are_in(path: impl AsRef<Path>) -> Result<bool> {
        let path = path.as_ref();
        let header = || -> Result<Vec<u8>> {
            let (mut file, mut length, mut header) = (File::open(path)?, Vec::new(), Vec::new());
            (&mut file).take(8).read_to_end(&mut length)?;
            let length = length.first_chunk().map_or(0, |&bytes| u64::from_le_bytes(bytes));
            file.take(length.min(LARGEST_HEADER)).read_to_end(&mut header)?;
            Ok(header)
        };
        let header =
            header().map_err(|error| Error::File { path: path.to_owned(), source: Box::new(error) })?;
        let header: Option<Header> = serde_json::from_slice(&header).ok();
        Ok(header.is_some_and(|header| header.metadata.contains_key(KEY)))
    }

    /// What [`Weights::read`] reads, from memory.
    ///
    /// # Errors
    /// As there.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        if bytes.len() as u64 > LARGEST_FILE {
            return Err(Error::TooLarge { limit: LARGEST_FILE });
        }
        let Checked { tensors: file, metadata: header, .. } = checked(bytes)?;
        let description = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let description = description.ok_or(Error::NotAHead { key: KEY })?;
        let Description { config, metadata } =
            serde_json::from_str(description).map_err(Error::Description)?;
        config.check()?;
        Ok(Self { config, values: values(&file, &config)?, metadata })
    }

    /// Writes the weights as safetensors: one f32 tensor per parameter under its name, and under `attn-head` in the
    /// metadata the configuration and [`Weights::metadata`] as JSON. The file appears whole or not at all.
    ///
    /// # Errors
    /// If the weights do not fit their configuration, or the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let bytes = self.to_bytes()?;
        Ok(gs_scene::write_atomically(path.as_ref(), |file| file.write_all(&bytes))?)
    }

    /// What [`Weights::write`] writes, into memory.
    ///
    /// # Errors
    /// If the weights do not fit their configuration.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.check()?;
        let description = Description { config: self.config, metadata: self.metadata.clone() };
        let description = serde_json::to_string(&description).map_err(Error::Description)?;
        let bytes: Vec<u8> = self.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let layout = Layout::new(&self.config);
        let tensors = layout.parameters.iter().map(|p| {
            let data = &bytes[4 * p.offset..][..4 * p.len()];
            (p.name.as_str(), Dtype::F32, &p.shape[..], data)
        });
        let bytes = to_bytes(tensors, HashMap::from([(KEY.to_owned(), description)]))?;
        if bytes.len() as u64 > LARGEST_FILE {
            return Err(Error::TooLarge { limit: LARGEST_FILE });
        }
        Ok(bytes)
    }
}

/// The numbers of all parameters, in their order.
fn values(file: &SafeTensors<'_>, config: &Config) -> Result<Vec<f32>> {
    let layout = Layout::new(config);
    let mut found: BTreeMap<&str, TensorView<'_>> = file.iter().collect();
    let (mut values, mut problems) = (Vec::new(), Vec::new());
    for parameter in layout.parameters {
        let fault = match found.remove(parameter.name.as_str()) {
            None => WeightFault::Missing,
            Some(view) if view.dtype() != Dtype::F32 => {
                WeightFault::Type { expected: Dtype::F32, found: view.dtype() }
            }
            Some(view) if view.shape() != parameter.shape => {
                WeightFault::Shape { expected: parameter.shape, found: view.shape().to_vec() }
            }
            Some(view) => {
                let start = values.len();
                values.extend(view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)));
                if values[start..].iter().all(|v| v.is_finite()) {
                    continue;
                }
                WeightFault::NotFinite
            }
        };
        problems.push(WeightProblem { name: parameter.name, fault });
    }
    let unexpected = |name: &str| WeightProblem { name: name.to_owned(), fault: WeightFault::Unexpected };
    problems.extend(found.into_keys().map(unexpected));
    if problems.is_empty() { Ok(values) } else { Err(Error::Weights { problems }) }
}
