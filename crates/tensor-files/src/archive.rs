//! A ZIP archive of stored entries, of which `data.pkl` builds the values and `data/<key>` are the storages.

use crate::file::Stored;
use crate::pickle::{MAX_PICKLE, MAX_TEXT};
use crate::{TorchError as Error, TorchResult as Result, TorchRule as Rule};
use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::PathBuf;
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

/// An open archive.
pub(crate) struct Archive {
    path: PathBuf,
    /// Bytes of the file.
    length: u64,
    archive: ZipArchive<BufReader<File>>,
    /// What the names of all entries begin with.
    prefix: String,
}

impl Archive {
    /// Reads the directory, and the pickle.
    pub(crate) fn open(path: PathBuf, file: File, length: u64) -> Result<(Self, Vec<u8>)> {
        let broken = |rule| Error::Torch { path: path.clone(), rule };
        let archive = ZipArchive::new(BufReader::new(file));
        let archive = archive.map_err(|source| broken(Rule::Archive { reason: source.to_string() }))?;
        // A name that cannot be decoded is none of PyTorch's.
        let names = archive.file_names().flatten();
        let is_pickle = |name: &Cow<str>| name.ends_with("/data.pkl") && name.len() <= MAX_TEXT;
        let pickles: Vec<String> = names.filter(is_pickle).map(Cow::into_owned).collect();
        let [name] = pickles.as_slice() else {
            return Err(broken(Rule::PickleEntries { found: pickles.len() }));
        };
        let prefix = name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
        let mut archive = Self { path, length, archive, prefix };
        let byteorder = format!("{}byteorder", archive.prefix);
        // Files from before PyTorch 2.1 do not state it, and are little endian.
        if archive.archive.index_for_name(&byteorder).is_some() {
            let found = archive.find(&byteorder)?;
            let found = archive.read(&Stored { length: found.length.min(16), ..found })?;
            if found != b"little" {
                let found = String::from_utf8_lossy(&found).into_owned();
                return Err(archive.broken(Rule::ByteOrder { found }));
            }
        }
        let entry = archive.find(name)?;
        if entry.length > MAX_PICKLE {
            return Err(archive.broken(Rule::PickleSize { found: entry.length }));
        }
        let pickle = archive.read(&entry)?;
        Ok((archive, pickle))
    }

    /// The entry of a storage.
    pub(crate) fn storage(&mut self, key: &str) -> Result<Stored> {
        self.find(&format!("{}data/{key}", self.prefix))
    }

    fn broken(&self, rule: Rule) -> Error {
        Error::Torch { path: self.path.clone(), rule }
    }

    fn find(&mut self, name: &str) -> Result<Stored> {
        let missing = || Rule::MissingEntry { entry: name.to_owned() };
        let index = self.archive.index_for_name(name).ok_or_else(|| self.broken(missing()))?;
        let (path, length) = (&self.path, self.length);
        let broken = |rule| Error::Torch { path: path.clone(), rule };
        let file = self.archive.by_index_raw(index);
        let file = file.map_err(|source| broken(Rule::Archive { reason: source.to_string() }))?;
        let not_stored = |found| broken(Rule::NotStored { entry: name.to_owned(), found });
        if file.encrypted() {
            return Err(not_stored("encrypted"));
        }
        if file.compression() != CompressionMethod::Stored || file.size() != file.compressed_size() {
            return Err(not_stored("compressed"));
        }
        let offset = file.data_start().unwrap_or(u64::MAX);
        let entry = Stored { name: name.to_owned(), index, offset, length: file.size() };
        let end = entry.offset.saturating_add(entry.length);
        if end > length {
            return Err(broken(Rule::EntryRange { entry: entry.name, end, length }));
        }
        Ok(entry)
    }

    /// The entry's bytes, or so many of them as its length says.
    pub(crate) fn read(&mut self, entry: &Stored) -> Result<Vec<u8>> {
        let path = &self.path;
        let file = self.archive.by_index(entry.index).map_err(|source| match source {
            ZipError::Io(source) => Error::Read { path: path.clone(), source },
            other => Error::Torch { path: path.clone(), rule: Rule::Archive { reason: other.to_string() } },
        })?;
        let mut bytes = Vec::new();
        // The directory's length was checked against the file's; the reader compares the checksum at the end.
        let read = file.take(entry.length.saturating_add(1)).read_to_end(&mut bytes);
        match read {
            Ok(_) => Ok(bytes),
            Err(source) if source.kind() == std::io::ErrorKind::InvalidData => {
                Err(self.broken(Rule::Checksum { entry: entry.name.clone() }))
            }
            Err(source) => Err(Error::Read { path: self.path.clone(), source }),
        }
    }
}
