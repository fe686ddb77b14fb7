//! Files of tensors that are kept from run to run: caches and checkpoints. Each has a header of its own and a checksum, so that what a
//! disk or a copy has garbled is told where it is read, and not by what comes of it.

use crate::{Checked, SafetensorsFault, checked, to_bytes};
use crc32fast::Hasher;
use gs_scene::write_durably;
use safetensors::tensor::{Dtype, Metadata};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// A tensor to be kept: name, type, shape, and its values as little-endian bytes.
pub type KeptTensor = (String, Dtype, Vec<usize>, Vec<u8>);

/// Shape and bytes of a tensor.
pub type Stored<'a> = (&'a [usize], &'a [u8]);

/// What is wrong with a file that is kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeptFault {
    /// The system does not give it.
    #[error("cannot read")]
    Read(#[source] std::io::Error),
    /// The system does not take it.
    #[error(transparent)]
    Write(#[from] gs_scene::Error),
    /// Not what safetensors files look like, or cut short.
    #[error("no whole safetensors file")]
    Tensors(#[from] SafetensorsFault),
    /// Of another kind, or of another version of this code.
    #[error("no {kind} of this version")]
    Kind {
        /// What it should be.
        kind: &'static str,
    },
    /// A header that holds something else.
    #[error("the header is not understood")]
    Header(#[from] serde_json::Error),
    /// Bytes that are not those that were written.
    #[error("damaged: the checksum of what it holds is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// As written.
        expected: u32,
        /// As read.
        found: u32,
    },
    /// A tensor that is not there or has another type or shape.
    #[error("tensor {name}: {found}, expected {expected}")]
    Tensor {
        /// Its name.
        name: String,
        /// What there is.
        found: String,
        /// What should be there.
        expected: String,
    },
    /// A tensor whose values make nothing that they should.
    #[error(transparent)]
    Scene(gs_scene::Error),
}

/// What stands in the metadata, under the kind of the file.
#[derive(Serialize, Deserialize)]
struct Sealed {
    /// CRC-32 of the header and of all tensors.
    crc32: u32,
    /// JSON.
    header: String,
}

/// The tensors of a file that was read whole.
pub struct Kept {
    bytes: Vec<u8>,
    /// Where the values begin.
    start: usize,
    metadata: Metadata,
}

/// Writes tensors with a header, whole or not at all, and flushes them to the disk.
///
/// # Errors
/// If a tensor has not as many bytes as its shape says, or the file cannot be written.
pub fn write_kept(
    path: &Path,
    kind: &'static str,
    header: &impl Serialize,
    tensors: &[KeptTensor],
) -> Result<(), KeptFault> {
    let header = serde_json::to_string(header)?;
    let mut sorted: Vec<&KeptTensor> = tensors.iter().collect();
    sorted.sort_by(|a, b| a.0.cmp(&b.0));
    let parts =
        sorted.iter().map(|(name, dtype, shape, data)| (name.as_str(), *dtype, &shape[..], &data[..]));
    let sealed = Sealed { crc32: checksum(&header, parts), header };
    let parts =
        tensors.iter().map(|(name, dtype, shape, data)| (name.as_str(), *dtype, &shape[..], &data[..]));
    let bytes = to_bytes(parts, HashMap::from([(kind.to_owned(), serde_json::to_string(&sealed)?)]))?;
    Ok(write_durably(path, |out| out.write_all(&bytes))?)
}

fn checksum<'a>(header: &str, sorted: impl Iterator<Item = (&'a str, Dtype, &'a [usize], &'a [u8])>) -> u32 {
    let mut sum = Hasher::new();
    sum.update(header.as_bytes());
    for (name, dtype, shape, data) in sorted {
        sum.update(format!("\n{name} {dtype:?} {shape:?}\n").as_bytes());
        sum.update(data);
    }
    sum.finalize()
}

impl Kept {
    /// Reads what [`write_kept`] wrote, and its header.
    ///
    /// # Errors
    /// If the file cannot be read, is of another kind, or does not hold what was written.
    pub fn read<H: DeserializeOwned>(path: &Path, kind: &'static str) -> Result<(H, Self), KeptFault> {
        Self::of_bytes(std::fs::read(path).map_err(KeptFault::Read)?, kind)
    }

    fn of_bytes<H: DeserializeOwned>(bytes: Vec<u8>, kind: &'static str) -> Result<(H, Self), KeptFault> {
        let Checked { metadata, start, .. } = checked(&bytes)?;
        let sealed = metadata.metadata().as_ref().and_then(|all| all.get(kind));
        let sealed = sealed.ok_or(KeptFault::Kind { kind })?;
        let Sealed { crc32: expected, header } =
            serde_json::from_str(sealed).map_err(|_| KeptFault::Kind { kind })?;
        let kept = Self { bytes, start, metadata };
        let mut names: Vec<String> = kept.metadata.tensors().into_keys().collect();
        names.sort();
        let parts = names.iter().filter_map(|name| {
            let (dtype, shape, data) = kept.get(name)?;
            Some((name.as_str(), dtype, shape, data))
        });
        let found = checksum(&header, parts);
        if found != expected {
            return Err(KeptFault::Checksum { expected, found });
        }
        Ok((serde_json::from_str(&header)?, kept))
    }

    fn get(&self, name: &str) -> Option<(Dtype, &[usize], &[u8])> {
        let info = self.metadata.info(name)?;
        let (from, to) = info.data_offsets;
        Some((info.dtype, &info.shape, &self.bytes[self.start + from..self.start + to]))
    }

    /// Shape and bytes of a tensor; none where there is none of that name.
    ///
    /// # Errors
    /// If it has another type or another number of axes.
    pub fn tensor(&self, name: &str, dtype: Dtype, axes: usize) -> Result<Option<Stored<'_>>, KeptFault> {
        match self.get(name) {
            Some((found, shape, data)) if found == dtype && shape.len() == axes => Ok(Some((shape, data))),
            Some((found, shape, _)) => Err(KeptFault::Tensor {
                name: name.to_owned(),
                found: format!("{found:?} {shape:?}"),
                expected: format!("{dtype:?} with {axes} axes"),
            }),
            None => Ok(None),
        }
    }

    /// Bytes of a tensor of this shape.
    ///
    /// # Errors
    /// If there is none, or it has another type or shape.
    pub fn expect(&self, name: &str, dtype: Dtype, expected: &[usize]) -> Result<&[u8], KeptFault> {
        let found = self.tensor(name, dtype, expected.len())?;
        found.filter(|(shape, _)| *shape == expected).map(|(_, data)| data).ok_or_else(|| KeptFault::Tensor {
            name: name.to_owned(),
            found: found.map_or_else(|| "not there".to_owned(), |(shape, _)| format!("{shape:?}")),
            expected: format!("{expected:?}"),
        })
    }
}

/// Little-endian bytes to numbers.
#[must_use]
pub fn singles(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|&value| f32::from_le_bytes(value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path) {
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let tensors = vec![
            ("b".to_owned(), Dtype::F32, vec![2], bytes(&[1.0, 2.0])),
            ("a".to_owned(), Dtype::U8, vec![1, 3], vec![7, 8, 9]),
        ];
        write_kept(path, "test", &"a header", &tensors).unwrap();
    }

    #[test]
    fn what_was_written_is_read_and_every_other_bit_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write(&path);
        let (header, kept): (String, _) = Kept::read(&path, "test").unwrap();
        assert_eq!(header, "a header");
        assert_eq!(singles(kept.expect("b", Dtype::F32, &[2]).unwrap()), [1.0, 2.0]);
        assert_eq!(kept.tensor("a", Dtype::U8, 2).unwrap(), Some((&[1, 3][..], &[7u8, 8, 9][..])));
        assert!(kept.tensor("c", Dtype::U8, 2).unwrap().is_none());
        assert!(matches!(kept.expect("a", Dtype::U8, &[3, 1]), Err(KeptFault::Tensor { .. })));
        assert!(matches!(kept.tensor("a", Dtype::F32, 2), Err(KeptFault::Tensor { .. })));

        let whole = std::fs::read(&path).unwrap();
        let read = |bytes: Vec<u8>| Kept::of_bytes::<String>(bytes, "test").map(|_| ());
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            // Spaces pad the header: nothing is read from them, and JSON takes other white space as well.
            let padding = whole[bit / 8] == b' ' && matches!(bytes[bit / 8], b'\t' | b'\n' | b'\r' | b' ');
            assert!(padding || read(bytes).is_err(), "bit {bit} of {}", whole.len() * 8);
        }
        for length in 0..whole.len() {
            assert!(read(whole[..length].to_vec()).is_err(), "{length} bytes");
        }
        assert!(matches!(Kept::read::<String>(&path, "other"), Err(KeptFault::Kind { .. })));
    }
}
