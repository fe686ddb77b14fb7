//! Files of `torch.save`: a ZIP archive of stored entries, of which `data.pkl` builds the values and `data/<key>` are
//! the storages behind its tensors.

mod known;
mod machine;
mod rule;
mod value;

pub use rule::TorchRule;
use value::MAX_TEXT;
pub(crate) use value::{Dtype, Pickle, Tensor, Value};

use crate::{Error, Result};
use TorchRule as Rule;
use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

/// Longest `data.pkl` that is read, bytes; some 70 of them stand for a tensor. What it builds takes up to a hundred
/// times as much memory, if somebody means harm.
pub(crate) const MAX_PICKLE: u64 = 1 << 23;
/// Most dimensions of a tensor.
pub(crate) const MAX_DIMENSIONS: usize = 8;

/// An open file of `torch.save`: the values are in memory, the storages are not.
pub(crate) struct TorchFile {
    path: PathBuf,
    length: u64,
    archive: ZipArchive<BufReader<File>>,
    /// What the names of all entries begin with.
    prefix: String,
    pub(crate) pickle: Pickle,
    /// Storages that numbers were read from; those of pictures are not among them.
    storages: HashMap<String, Vec<u8>>,
    /// Bytes in `storages`.
    held: u64,
}

/// Where an entry's bytes are.
struct Entry {
    index: usize,
    offset: u64,
    length: u64,
}

impl TorchFile {
    /// Reads the archive's directory and runs the pickle.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let unreadable = |source| Error::Read { path: path.to_path_buf(), source };
        let broken = |rule| Error::Torch { path: path.to_path_buf(), rule };
        let mut file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        let mut head = Vec::new();
        Read::take(&mut file, LEGACY.len() as u64).read_to_end(&mut head).map_err(unreadable)?;
        if head == LEGACY {
            return Err(broken(Rule::Legacy));
        }
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let archive = ZipArchive::new(BufReader::new(file));
        let mut archive = archive.map_err(|source| broken(Rule::Archive { reason: source.to_string() }))?;

        // A name that cannot be decoded is none of PyTorch's.
        let names = archive.file_names().flatten();
        let is_pickle = |name: &Cow<str>| name.ends_with("/data.pkl") && name.len() <= MAX_TEXT;
        let pickles: Vec<String> = names.filter(is_pickle).map(Cow::into_owned).collect();
        let [name] = pickles.as_slice() else {
            return Err(broken(Rule::PickleEntries { found: pickles.len() }));
        };
        let prefix = name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
        let mut reader = Entries { path, length, archive: &mut archive };
        let byteorder = format!("{prefix}byteorder");
        // Files from before PyTorch 2.1 do not state it, and are little endian.
        if reader.archive.index_for_name(&byteorder).is_some() {
            let found = reader.find(&byteorder)?;
            let found = reader.read(&byteorder, &Entry { length: found.length.min(16), ..found })?;
            if found != b"little" {
                let found = String::from_utf8_lossy(&found).into_owned();
                return Err(broken(Rule::ByteOrder { found }));
            }
        }
        let entry = reader.find(name)?;
        if entry.length > MAX_PICKLE {
            return Err(broken(Rule::PickleSize { found: entry.length }));
        }
        let pickle = reader.read(name, &entry)?;
        let pickle = machine::run(pickle).map_err(broken)?;
        let path = path.to_path_buf();
        Ok(Self { path, length, archive, prefix, pickle, storages: HashMap::new(), held: 0 })
    }

    /// Bytes of the file.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    fn broken(&self, rule: Rule) -> Error {
        Error::Torch { path: self.path.clone(), rule }
    }

    /// The entry of a tensor's storage, whose length is what the pickle states.
    fn storage(&mut self, tensor: &Tensor) -> Result<(String, Entry)> {
        let key = self.pickle.text(Value::Text(tensor.storage.key)).unwrap_or_default();
        let name = format!("{}data/{key}", self.prefix);
        let mut reader = Entries { path: &self.path, length: self.length, archive: &mut self.archive };
        let entry = reader.find(&name)?;
        let (elements, size) = (tensor.storage.elements, tensor.dtype().size());
        if elements.checked_mul(size) != Some(entry.length) {
            return Err(self.broken(Rule::StorageSize { entry: name, elements, size, found: entry.length }));
        }
        Ok((name, entry))
    }

    /// Where in the file the elements of a contiguous tensor lie: first byte and number of bytes.
    pub(crate) fn locate(&mut self, tensor: &Tensor) -> Result<(u64, u64)> {
        let (_, entry) = self.storage(tensor)?;
        let size = tensor.dtype().size();
        // The tensor lies within the storage, and the storage within the file: nothing overflows.
        Ok((entry.offset + tensor.offset * size, tensor.count() * size))
    }

    /// The elements of a tensor in row-major order. The caller has looked at its shape: a tensor may repeat the
    /// elements of a small storage without bound.
    pub(crate) fn numbers(&mut self, tensor: &Tensor) -> Result<Vec<f64>> {
        let size = tensor.dtype().size() as usize;
        let dtype = tensor.dtype();
        let decode = move |bytes: &[u8]| match dtype {
            Dtype::U8 => f64::from(bytes[0]),
            Dtype::I64 => i64::from_le_bytes(wide(bytes)) as f64,
            Dtype::F32 => f64::from(f32::from_le_bytes(wide(bytes))),
            Dtype::F64 => f64::from_le_bytes(wide(bytes)),
        };
        self.elements(tensor, size, decode)
    }

    /// As [`TorchFile::numbers`], of a tensor of whole numbers.
    pub(crate) fn integers(&mut self, tensor: &Tensor) -> Result<Vec<i64>> {
        self.elements(tensor, 8, |bytes| i64::from_le_bytes(wide(bytes)))
    }

    fn elements<T>(&mut self, tensor: &Tensor, size: usize, decode: impl Fn(&[u8]) -> T) -> Result<Vec<T>> {
        let (name, entry) = self.storage(tensor)?;
        if !self.storages.contains_key(&name) {
            self.held = self.held.saturating_add(entry.length);
            if self.held > self.length {
                return Err(self.broken(Rule::Overlap));
            }
            let mut reader = Entries { path: &self.path, length: self.length, archive: &mut self.archive };
            let bytes = reader.read(&name, &entry)?;
            self.storages.insert(name.clone(), bytes);
        }
        let bytes = &self.storages[&name];
        let shape = tensor.shape();
        let mut position = [0u64; MAX_DIMENSIONS];
        let mut elements = Vec::new();
        for _ in 0..tensor.count() {
            let place: u64 = position.iter().zip(&tensor.strides).map(|(&at, &stride)| at * stride).sum();
            let start = (tensor.offset + place) as usize * size;
            elements.push(decode(&bytes[start..start + size]));
            for (at, &length) in position.iter_mut().zip(shape).rev() {
                *at += 1;
                if *at < length {
                    break;
                }
                *at = 0;
            }
        }
        Ok(elements)
    }
}

/// How a file of PyTorch before 1.6 begins: a pickle of the number 0x1950a86a20f9469cfc6c.
const LEGACY: [u8; 14] = [0x80, 0x02, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19];

fn wide<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(bytes);
    array
}

/// Access to an archive by the names of its entries.
struct Entries<'a> {
    path: &'a Path,
    length: u64,
    archive: &'a mut ZipArchive<BufReader<File>>,
}

impl Entries<'_> {
    fn broken(&self, rule: Rule) -> Error {
        Error::Torch { path: self.path.to_path_buf(), rule }
    }

    fn find(&mut self, name: &str) -> Result<Entry> {
        let missing = || Rule::MissingEntry { entry: name.to_owned() };
        let index = self.archive.index_for_name(name).ok_or_else(|| self.broken(missing()))?;
        let (path, length) = (self.path, self.length);
        let broken = |rule| Error::Torch { path: path.to_path_buf(), rule };
        let file = self.archive.by_index_raw(index);
        let file = file.map_err(|source| broken(Rule::Archive { reason: source.to_string() }))?;
        let not_stored = |found| broken(Rule::NotStored { entry: name.to_owned(), found });
        if file.encrypted() {
            return Err(not_stored("encrypted"));
        }
        if file.compression() != CompressionMethod::Stored || file.size() != file.compressed_size() {
            return Err(not_stored("compressed"));
        }
        let entry = Entry { index, offset: file.data_start().unwrap_or(u64::MAX), length: file.size() };
        let end = entry.offset.saturating_add(entry.length);
        if end > length {
            return Err(broken(Rule::EntryRange { entry: name.to_owned(), end, length }));
        }
        Ok(entry)
    }

    /// The entry's bytes, or so many of them as its length says.
    fn read(&mut self, name: &str, entry: &Entry) -> Result<Vec<u8>> {
        let path = self.path;
        let file = self.archive.by_index(entry.index).map_err(|source| match source {
            ZipError::Io(source) => Error::Read { path: path.to_path_buf(), source },
            other => {
                Error::Torch { path: path.to_path_buf(), rule: Rule::Archive { reason: other.to_string() } }
            }
        })?;
        let mut bytes = Vec::new();
        // The directory's length was checked against the file's; the reader compares the checksum at the end.
        let read = file.take(entry.length.saturating_add(1)).read_to_end(&mut bytes);
        match read {
            Ok(_) => Ok(bytes),
            Err(source) if source.kind() == std::io::ErrorKind::InvalidData => {
                Err(self.broken(Rule::Checksum { entry: name.to_owned() }))
            }
            Err(source) => Err(Error::Read { path: self.path.to_path_buf(), source }),
        }
    }
}
