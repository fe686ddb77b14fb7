//! Little-endian binary files. Nothing is allocated for what a file announces but does not hold.

use super::unreadable;
use crate::{Error, FormatRule, Place, Result};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// A binary file and the place in it.
pub(crate) struct Binary {
    path: PathBuf,
    inner: BufReader<File>,
    at: u64,
    length: u64,
}

impl Binary {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = super::open(path).map_err(unreadable(path))?;
        let length = file.metadata().map_err(unreadable(path))?.len();
        Ok(Self { path: path.to_path_buf(), inner: BufReader::new(file), at: 0, length })
    }

    /// The error of a rule that is broken where reading has come to.
    pub(crate) fn broken(&self, rule: FormatRule) -> Error {
        Error::Format { path: self.path.clone(), place: Place::Byte(self.at), rule }
    }

    fn left(&self) -> u64 {
        self.length.saturating_sub(self.at)
    }

    fn require(&self, what: &'static str, wanted: u64) -> Result<()> {
        let held = self.left();
        if wanted > held { Err(self.broken(FormatRule::Cut { what, wanted, held })) } else { Ok(()) }
    }

    pub(crate) fn bytes<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N]> {
        self.require(what, N as u64)?;
        let mut bytes = [0; N];
        self.inner.read_exact(&mut bytes).map_err(unreadable(&self.path))?;
        self.at += N as u64;
        Ok(bytes)
    }

    pub(crate) fn u32(&mut self, what: &'static str) -> Result<u32> {
        Ok(u32::from_le_bytes(self.bytes(what)?))
    }

    pub(crate) fn i32(&mut self, what: &'static str) -> Result<i32> {
        Ok(i32::from_le_bytes(self.bytes(what)?))
    }

    pub(crate) fn u64(&mut self, what: &'static str) -> Result<u64> {
        Ok(u64::from_le_bytes(self.bytes(what)?))
    }

    pub(crate) fn f64(&mut self, what: &'static str) -> Result<f64> {
        Ok(f64::from_le_bytes(self.bytes(what)?))
    }

    pub(crate) fn f64s<const N: usize>(&mut self, what: &'static str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(what)?;
        }
        Ok(values)
    }

    /// A count of entries of at least `least` bytes each, which the rest of the file must have room for.
    pub(crate) fn count(&mut self, what: &'static str, least: u64) -> Result<u64> {
        let found = self.u64(what)?;
        let most = self.left() / least;
        if found > most { Err(self.broken(FormatRule::Count { what, found, most })) } else { Ok(found) }
    }

    /// Text up to a zero byte, which is taken too.
    pub(crate) fn text(&mut self, what: &'static str, most: usize) -> Result<String> {
        let mut text = Vec::new();
        loop {
            match self.bytes(what)? {
                [0] => break,
                _ if text.len() == most => return Err(self.broken(FormatRule::TooLong { what, most })),
                [byte] => text.push(byte),
            }
        }
        String::from_utf8(text).map_err(|_| self.broken(FormatRule::NotText { what }))
    }

    /// Passes over bytes.
    pub(crate) fn skip(&mut self, what: &'static str, bytes: u64) -> Result<()> {
        self.require(what, bytes)?;
        // Files longer than 2^63 bytes do not exist, and `bytes` is at most the rest of this one.
        self.inner.seek_relative(bytes as i64).map_err(unreadable(&self.path))?;
        self.at += bytes;
        Ok(())
    }

    /// Checks that everything has been read.
    pub(crate) fn end(&self) -> Result<()> {
        match self.left() {
            0 => Ok(()),
            bytes => Err(self.broken(FormatRule::Trailing { bytes })),
        }
    }
}
