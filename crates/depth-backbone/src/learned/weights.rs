//! The network's numbers, and their file: safetensors of half precision, a tensor per parameter.

use super::decode::{OUTPUTS, initial_bias};
use super::inputs::INPUTS;
use super::network::Architecture;
use crate::{Error, Result};
use half::f16;
use safetensors::{Dtype, SafeTensors};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use tensor_files::{Checked, WeightFault, WeightProblem, checked, to_bytes};

/// Key of the description in the metadata: all of it is one text, because the order of several keys would be arbitrary.
const KEY: &str = "learned-depth";
/// Largest file, bytes.
const LARGEST_FILE: u64 = 16 << 20;

/// All numbers of the network behind the plane sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthWeights {
    /// One layer after the other.
    pub values: Vec<f32>,
    /// How they were trained.
    pub metadata: BTreeMap<String, String>,
}

impl DepthWeights {
    /// Where training begins. An untrained network nearly keeps stereo's surface.
    #[must_use]
    pub fn initial(seed: u64) -> Self {
        let architecture = Architecture::new(INPUTS, OUTPUTS);
        let mut values = vec![0.0; architecture.len];
        // splitmix64.
        let mut state = seed;
        let mut draw = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^= z >> 31;
            (z >> 40) as f32 / 8_388_608.0 - 1.0
        };
        for layer in &architecture.layers {
            // Blocks begin as the identity, and the outputs as their biases (Zhang et al. 2019, "Fixup").
            let silent = layer.name.ends_with(".second") || layer.name == "out";
            // He et al. 2015, uniform.
            let fan_in = (layer.side * layer.side * layer.inputs) as f32;
            let bound = if silent { 0.0 } else { (6.0 / fan_in).sqrt() };
            values[layer.offset..][..layer.weights()].iter_mut().for_each(|v| *v = bound * draw() + 0.0);
            if layer.name == "out" {
                let bias = &mut values[layer.offset + layer.weights()..][..layer.outputs];
                bias.iter_mut().enumerate().for_each(|(i, v)| *v = initial_bias(i));
            }
        }
        Self { values, metadata: BTreeMap::new() }
    }

    /// That there are as many as the network has, all finite.
    pub(crate) fn check(&self) -> Result<()> {
        let architecture = Architecture::new(INPUTS, OUTPUTS);
        if self.values.len() != architecture.len {
            let (found, expected) = (self.values.len() as f64, "as many as the network of learned depth has");
            return Err(Error::Setting { setting: "number of weights", found, expected });
        }
        match self.values.iter().position(|v| !v.is_finite()) {
            None => Ok(()),
            Some(index) => {
                let layer = architecture.layers.iter().rfind(|layer| layer.offset <= index);
                let name = layer.map_or_else(String::new, |layer| layer.name.clone());
                Err(Error::DepthWeights {
                    problems: vec![WeightProblem { name, fault: WeightFault::NotFinite }],
                })
            }
        }
    }

    /// The first eight hexadecimal digits of a hash of the numbers.
    #[must_use]
    pub fn name(&self) -> String {
        let mut hash = Sha256::new();
        self.values.iter().for_each(|value| hash.update(value.to_le_bytes()));
        hash.finalize()[..4].iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Reads a file that [`DepthWeights::write`] has written.
    ///
    /// # Errors
    /// If it cannot be read, is no such file, or its tensors are not those of the network; all that are not are named.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let read = || {
            let mut bytes = Vec::new();
            File::open(path)?.take(LARGEST_FILE).read_to_end(&mut bytes)?;
            Self::from_bytes(&bytes)
        };
        read().map_err(|error| Error::DepthWeightsFile { path: path.to_owned(), source: Box::new(error) })
    }

    /// What [`DepthWeights::read`] reads, from memory.
    ///
    /// # Errors
    /// As there.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let Checked { tensors, metadata: header, .. } = checked(bytes)?;
        let description = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let metadata =
            description.and_then(|text| serde_json::from_str(text).ok()).ok_or(Error::NotDepthWeights)?;
        Ok(Self { values: values(&tensors)?, metadata })
    }

    /// Writes the weights, rounded to half precision. The file appears whole or not at all.
    ///
    /// # Errors
    /// If a weight is not finite, or the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let bytes = self.to_bytes()?;
        Ok(gs_scene::write_atomically(path.as_ref(), |file| file.write_all(&bytes))?)
    }

    /// What [`DepthWeights::write`] writes, into memory.
    ///
    /// # Errors
    /// If a weight is not finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.check()?;
        let data: Vec<u8> = self.values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        let parameters = parameters();
        let tensors = parameters.iter().map(|(name, shape, offset)| {
            (name.as_str(), Dtype::F16, &shape[..], &data[2 * offset..][..2 * size(shape)])
        });
        let description =
            serde_json::to_string(&self.metadata).map_err(tensor_files::SafetensorsFault::Header)?;
        Ok(to_bytes(tensors, HashMap::from([(KEY.to_owned(), description)]))?)
    }
}

fn size(shape: &[usize]) -> usize {
    shape.iter().product()
}

/// Name, shape and first number of every parameter, in order.
fn parameters() -> Vec<(String, Vec<usize>, usize)> {
    let both = |layer: &super::network::Layer| {
        let weight = vec![layer.side, layer.side, layer.inputs, layer.outputs];
        [
            (format!("{}.weight", layer.name), weight, layer.offset),
            (format!("{}.bias", layer.name), vec![layer.outputs], layer.offset + layer.weights()),
        ]
    };
    Architecture::new(INPUTS, OUTPUTS).layers.iter().flat_map(both).collect()
}

/// The numbers of all parameters.
fn values(file: &SafeTensors<'_>) -> Result<Vec<f32>> {
    let mut found: BTreeMap<&str, _> = file.iter().collect();
    let (mut values, mut problems) = (Vec::new(), Vec::new());
    for (name, expected, _) in parameters() {
        let fault = match found.remove(name.as_str()) {
            None => WeightFault::Missing,
            Some(view) if view.dtype() != Dtype::F16 => {
                WeightFault::Type { expected: Dtype::F16, found: view.dtype() }
            }
            Some(view) if view.shape() != expected => {
                WeightFault::Shape { expected, found: view.shape().to_vec() }
            }
            Some(view) => {
                let start = values.len();
                values.extend(
                    view.data().as_chunks().0.iter().map(|bytes| f16::from_le_bytes(*bytes).to_f32()),
                );
                if values[start..].iter().all(|v: &f32| v.is_finite()) {
                    continue;
                }
                WeightFault::NotFinite
            }
        };
        problems.push(WeightProblem { name, fault });
    }
    let unexpected = |name: &str| WeightProblem { name: name.to_owned(), fault: WeightFault::Unexpected };
    problems.extend(found.into_keys().map(unexpected));
    if problems.is_empty() { Ok(values) } else { Err(Error::DepthWeights { problems }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_holds_the_numbers_in_half_precision() {
        let weights =
            DepthWeights { metadata: BTreeMap::from([("a".into(), "b".into())]), ..DepthWeights::initial(3) };
        let bytes = weights.to_bytes().unwrap();
        assert!(bytes.len() < 2_000_000, "{}", bytes.len());
        let read = DepthWeights::from_bytes(&bytes).unwrap();
        assert_eq!(read.metadata, weights.metadata);
        for (a, b) in read.values.iter().zip(&weights.values) {
            assert!((a - b).abs() <= b.abs() / 1024.0 + 1e-7, "{a} {b}");
        }
        // Rounded once, they stay.
        assert_eq!(DepthWeights::from_bytes(&read.to_bytes().unwrap()).unwrap(), read);
        assert_ne!(DepthWeights::initial(4).name(), DepthWeights::initial(3).name());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.safetensors");
        read.write(&path).unwrap();
        assert_eq!(DepthWeights::read(&path).unwrap(), read);
    }

    #[test]
    fn files_that_are_cut_damaged_or_of_something_else_are_refused_by_name() {
        let bytes = DepthWeights::initial(0).to_bytes().unwrap();
        for length in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
            assert!(DepthWeights::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        let mut other = bytes.clone();
        let start = bytes.windows(9).position(|name| name == b"stem.bias").unwrap();
        other[start..start + 9].copy_from_slice(b"item.bias");
        let error = DepthWeights::from_bytes(&other).unwrap_err().to_string();
        assert!(
            error.contains("stem.bias is missing") && error.contains("item.bias is unexpected"),
            "{error}"
        );
        let mut infinite = DepthWeights::initial(0);
        infinite.values[5] = f32::INFINITY;
        let error = infinite.to_bytes().unwrap_err().to_string();
        assert_eq!(
            error,
            "the weights of the learned depth do not fit: stem holds a value that is not finite"
        );
        infinite.values.pop();
        assert!(matches!(infinite.check(), Err(Error::Setting { setting: "number of weights", .. })));
        let metadata = HashMap::from([("attn-head".to_owned(), "{}".to_owned())]);
        let none = to_bytes(std::iter::empty::<(&str, Dtype, &[usize], &[u8])>(), metadata).unwrap();
        assert!(matches!(DepthWeights::from_bytes(&none), Err(Error::NotDepthWeights)));
        let missing = DepthWeights::read("no/such/file").unwrap_err();
        assert!(matches!(missing, Error::DepthWeightsFile { .. }), "{missing}");
    }
}
