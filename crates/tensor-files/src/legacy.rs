//! The format of PyTorch before 1.6, in which many published weights still are: pickles of a magic number, a version,
//! the machine, the values and the keys of the storages; then each storage, in the order of the keys: its number of
//! elements (i64), and the elements.

use crate::file::Stored;
use crate::pickle::{MAX_PICKLE, Pickle, Value, run};
use crate::{TorchError as Error, TorchResult as Result, TorchRule as Rule};
use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

/// How a file begins: a pickle of the number 0x1950a86a20f9469cfc6c, PROTO 2 and LONG1 of ten bytes up to STOP.
pub(crate) const MAGIC: [u8; 15] =
    [0x80, 0x02, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, b'.'];
/// The one version of the format.
const VERSION: i64 = 1001;

/// An open file.
pub(crate) struct Legacy {
    path: PathBuf,
    file: File,
    storages: HashMap<String, Stored>,
}

impl Legacy {
    /// Runs the pickles, and finds the storages.
    pub(crate) fn open(path: PathBuf, mut file: File, length: u64) -> Result<(Self, Pickle)> {
        let broken = |rule| Error::Torch { path: path.clone(), rule };
        let unreadable = |source| Error::Read { path: path.clone(), source };
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        Read::take(&mut file, MAX_PICKLE).read_to_end(&mut bytes).map_err(unreadable)?;
        let run = |bytes, start| {
            run(bytes, start).map_err(|rule| match rule {
                Rule::Truncated { .. } if length > MAX_PICKLE => broken(Rule::PickleSize { found: length }),
                rule => broken(rule),
            })
        };
        let (mut pickle, mut position) = run(bytes, MAGIC.len())?;
        if pickle.root() != Value::Int(VERSION) {
            return Err(broken(Rule::LegacyVersion));
        }
        (pickle, position) = run(pickle.into_bytes(), position)?;
        if pickle.get(pickle.root(), "little_endian") != Some(Value::Bool(true)) {
            return Err(broken(Rule::ByteOrder { found: "big".to_owned() }));
        }
        let (values, after) = run(pickle.into_bytes(), position)?;
        let (keys, after) = run(values.bytes().to_vec(), after)?;
        let sizes: HashMap<&str, u64> = values.storages().collect();
        let listed = keys.items(keys.root()).ok_or_else(|| broken(Rule::LegacyKeys))?;
        let mut storages = HashMap::new();
        let mut offset = after as u64;
        for (index, &key) in listed.iter().enumerate() {
            let name = keys.text(key).ok_or_else(|| broken(Rule::LegacyKeys))?;
            // Bytes of an element; nothing refers to a storage that the values do not name.
            let size = *sizes.get(name).ok_or_else(|| broken(Rule::LegacyKeys))?;
            let entry = format!("storage {name}");
            let cut = |end: u64| broken(Rule::EntryRange { entry: entry.clone(), end, length });
            let start = offset.saturating_add(8);
            if start > length {
                return Err(cut(start));
            }
            let mut count = [0; 8];
            file.seek(SeekFrom::Start(offset)).map_err(unreadable)?;
            file.read_exact(&mut count).map_err(unreadable)?;
            let bytes = u64::from_le_bytes(count).saturating_mul(size);
            let end = start.saturating_add(bytes);
            if end > length {
                return Err(cut(end));
            }
            let stored = Stored { name: entry, index, offset: start, length: bytes };
            if storages.insert(name.to_owned(), stored).is_some() {
                return Err(broken(Rule::LegacyKeys));
            }
            offset = end;
        }
        Ok((Self { path, file, storages }, values))
    }

    /// Where a storage lies.
    pub(crate) fn storage(&self, key: &str) -> Result<Stored> {
        let missing = || Rule::MissingEntry { entry: format!("storage {key}") };
        let stored = self.storages.get(key).cloned();
        stored.ok_or_else(|| Error::Torch { path: self.path.clone(), rule: missing() })
    }

    /// The bytes of a storage.
    pub(crate) fn read(&mut self, stored: &Stored) -> Result<Vec<u8>> {
        let unreadable = |source| Error::Read { path: self.path.clone(), source };
        self.file.seek(SeekFrom::Start(stored.offset)).map_err(unreadable)?;
        // The length was checked against the file's.
        let mut bytes = vec![0; stored.length as usize];
        self.file.read_exact(&mut bytes).map_err(unreadable)?;
        Ok(bytes)
    }
}
