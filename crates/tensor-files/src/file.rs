//! Files of `torch.save`: values in memory, storages on disk.

use crate::archive::Archive;
use crate::legacy::{Legacy, MAGIC};
use crate::pickle::{MAX_DIMENSIONS, run};
use crate::{Dtype, Pickle, Tensor, TorchError as Error, TorchResult as Result, TorchRule as Rule, Value};
use half::{bf16, f16};
use std::collections::HashMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// An open file of `torch.save`: the values are in memory, the storages are not.
pub struct TorchFile {
    path: PathBuf,
    length: u64,
    container: Container,
    pickle: Pickle,
    /// Storages that numbers were read from.
    storages: HashMap<String, Vec<u8>>,
    /// Bytes in `storages`.
    held: u64,
}

enum Container {
    Archive(Archive),
    Legacy(Legacy),
}

/// Where the bytes of a storage or another entry are.
#[derive(Debug, Clone)]
pub(crate) struct Stored {
    pub(crate) name: String,
    pub(crate) index: usize,
    pub(crate) offset: u64,
    pub(crate) length: u64,
}

impl TorchFile {
    /// Reads the directory of the file and runs its pickle.
    ///
    /// # Errors
    /// If the file cannot be read or breaks a rule of its format.
    pub fn open(path: &Path) -> Result<Self> {
        let unreadable = |source| Error::Read { path: path.to_path_buf(), source };
        // A FIFO would be waited for.
        if !std::fs::metadata(path).map_err(unreadable)?.is_file() {
            return Err(unreadable(std::io::Error::new(ErrorKind::InvalidInput, "it is no regular file")));
        }
        let mut file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        let mut head = Vec::new();
        Read::take(&mut file, MAGIC.len() as u64).read_to_end(&mut head).map_err(unreadable)?;
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let path = path.to_path_buf();
        let (container, pickle) = if head == MAGIC {
            let (legacy, pickle) = Legacy::open(path.clone(), file, length)?;
            (Container::Legacy(legacy), pickle)
        } else {
            let (archive, pickle) = Archive::open(path.clone(), file, length)?;
            let (pickle, _) = run(pickle, 0).map_err(|rule| Error::Torch { path: path.clone(), rule })?;
            (Container::Archive(archive), pickle)
        };
        Ok(Self { path, length, container, pickle, storages: HashMap::new(), held: 0 })
    }

    /// The values.
    pub fn pickle(&self) -> &Pickle {
        &self.pickle
    }

    /// Bytes of the file.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Tensors by name, if the file holds a dictionary of them (a state dictionary), in its order. What is no tensor is
    /// left out, and so is a name beyond 4096 bytes.
    pub fn state(&self) -> Option<Vec<(&str, Tensor)>> {
        let entries = self.pickle.entries(self.pickle.root())?;
        let named =
            |&(name, value): &(Value, Value)| Some((self.pickle.text(name)?, *self.pickle.tensor(value)?));
        Some(entries.iter().filter_map(named).collect())
    }

    fn broken(&self, rule: Rule) -> Error {
        Error::Torch { path: self.path.clone(), rule }
    }

    /// The bytes of a tensor's storage, whose length is what the pickle states.
    fn storage(&mut self, tensor: &Tensor) -> Result<Stored> {
        let key = self.pickle.text(Value::Text(tensor.storage.key)).unwrap_or_default();
        let stored = match &mut self.container {
            Container::Archive(archive) => archive.storage(key)?,
            Container::Legacy(legacy) => legacy.storage(key)?,
        };
        let (elements, size) = (tensor.storage.elements, tensor.dtype().size());
        if elements.checked_mul(size) != Some(stored.length) {
            let (entry, found) = (stored.name, stored.length);
            return Err(self.broken(Rule::StorageSize { entry, elements, size, found }));
        }
        Ok(stored)
    }

    /// Where in the file the elements of a contiguous tensor lie: first byte and number of bytes.
    ///
    /// # Errors
    /// If its storage is absent, cut off or damaged, or cannot be read.
    pub fn locate(&mut self, tensor: &Tensor) -> Result<(u64, u64)> {
        let stored = self.storage(tensor)?;
        let size = tensor.dtype().size();
        // The tensor lies within the storage, and the storage within the file: nothing overflows.
        Ok((stored.offset + tensor.offset * size, tensor.count() * size))
    }

    /// The elements of a tensor in row-major order. The caller has looked at its shape: a tensor may repeat the
    /// elements of a small storage without bound.
    ///
    /// # Errors
    /// If its storage is absent, cut off or damaged, or cannot be read.
    pub fn numbers(&mut self, tensor: &Tensor) -> Result<Vec<f64>> {
        let size = tensor.dtype().size() as usize;
        let dtype = tensor.dtype();
        let decode = move |bytes: &[u8]| match dtype {
            Dtype::U8 => f64::from(bytes[0]),
            Dtype::I64 => i64::from_le_bytes(wide(bytes)) as f64,
            Dtype::F16 => f16::from_le_bytes(wide(bytes)).to_f64(),
            Dtype::BF16 => bf16::from_le_bytes(wide(bytes)).to_f64(),
            Dtype::F32 => f64::from(f32::from_le_bytes(wide(bytes))),
            Dtype::F64 => f64::from_le_bytes(wide(bytes)),
        };
        self.elements(tensor, size, decode)
    }

    /// As [`TorchFile::numbers`], of a tensor of whole numbers.
    ///
    /// # Errors
    /// If its storage is absent, cut off or damaged, or cannot be read.
    pub fn integers(&mut self, tensor: &Tensor) -> Result<Vec<i64>> {
        self.elements(tensor, 8, |bytes| i64::from_le_bytes(wide(bytes)))
    }

    fn elements<T>(&mut self, tensor: &Tensor, size: usize, decode: impl Fn(&[u8]) -> T) -> Result<Vec<T>> {
        let stored = self.storage(tensor)?;
        if !self.storages.contains_key(&stored.name) {
            self.held = self.held.saturating_add(stored.length);
            if self.held > self.length {
                return Err(self.broken(Rule::Overlap));
            }
            let bytes = match &mut self.container {
                Container::Archive(archive) => archive.read(&stored)?,
                Container::Legacy(legacy) => legacy.read(&stored)?,
            };
            self.storages.insert(stored.name.clone(), bytes);
        }
        let bytes = &self.storages[&stored.name];
        let shape = tensor.shape();
        let mut position = [0u64; MAX_DIMENSIONS];
        let mut elements = Vec::new();
        for _ in 0..tensor.count() {
            let place: u64 =
                position.iter().zip(&tensor.strides).map(|(&index, &stride)| index * stride).sum();
            let start = (tensor.offset + place) as usize * size;
            elements.push(decode(&bytes[start..start + size]));
            for (index, &length) in position.iter_mut().zip(shape).rev() {
                *index += 1;
                if *index < length {
                    break;
                }
                *index = 0;
            }
        }
        Ok(elements)
    }
}

fn wide<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(bytes);
    array
}
