//! Text files line by line.

use super::unreadable;
use crate::{Error, FormatRule, Place, Result};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// A text file and the line in it.
pub(crate) struct Lines {
    path: PathBuf,
    inner: BufReader<File>,
    buffer: Vec<u8>,
    number: usize,
}

/// A line without its end, spaces around it taken off.
pub(crate) struct Line<'a> {
    path: &'a Path,
    pub(crate) number: usize,
    pub(crate) text: &'a str,
}

/// Longest line: a photograph's whole list of features in COLMAP's text model has a few MB.
const MAX_LINE: usize = 1 << 26;

impl Lines {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = super::open(path).map_err(unreadable(path))?;
        Ok(Self::behind(path, BufReader::new(file), 0))
    }

    /// The next line, whatever it holds.
    pub(crate) fn next_line(&mut self) -> Result<Option<Line<'_>>> {
        self.buffer.clear();
        let most = MAX_LINE as u64 + 1;
        let read = (&mut self.inner).take(most).read_until(b'\n', &mut self.buffer);
        if read.map_err(unreadable(&self.path))? == 0 {
            return Ok(None);
        }
        self.number += 1;
        let broken = |rule| Error::Format { path: self.path.clone(), place: Place::Line(self.number), rule };
        if self.buffer.len() > MAX_LINE {
            return Err(broken(FormatRule::TooLong { what: "line", most: MAX_LINE }));
        }
        let text = std::str::from_utf8(&self.buffer);
        let text = text.map_err(|_| broken(FormatRule::NotText { what: "line" }))?;
        // Windows' editors put a byte-order mark before the first line.
        let text = if self.number == 1 { text.trim_start_matches('\u{feff}') } else { text };
        Ok(Some(Line { path: &self.path, number: self.number, text: text.trim() }))
    }

    /// The lines behind the first so many, which were read already.
    pub(crate) fn behind(path: &Path, inner: BufReader<File>, number: usize) -> Self {
        Self { path: path.to_path_buf(), inner, buffer: Vec::new(), number }
    }

    /// The next line that is neither empty nor a comment (`#`).
    pub(crate) fn next_entry(&mut self) -> Result<Option<Line<'_>>> {
        // Asked twice because the borrow of a returned line reaches to the end of the function.
        loop {
            match self.next_line()? {
                None => return Ok(None),
                Some(line) if line.text.is_empty() || line.text.starts_with('#') => {}
                Some(_) => break,
            }
        }
        let text = std::str::from_utf8(&self.buffer).unwrap_or_default();
        let text = if self.number == 1 { text.trim_start_matches('\u{feff}') } else { text };
        Ok(Some(Line { path: &self.path, number: self.number, text: text.trim() }))
    }
}

impl<'a> Line<'a> {
    pub(crate) fn broken(&self, rule: FormatRule) -> Error {
        Error::Format { path: self.path.to_path_buf(), place: Place::Line(self.number), rule }
    }

    /// The words, between spaces, tabs or commas.
    pub(crate) fn words(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty())
    }

    /// The first `N` words and what follows them, spaces taken off; `expected` lists the words.
    pub(crate) fn split<const N: usize>(&self, expected: &'static str) -> Result<([&'a str; N], &'a str)> {
        let mut rest = self.text;
        let mut words = [""; N];
        for (found, word) in words.iter_mut().enumerate() {
            if rest.is_empty() {
                return Err(self.broken(FormatRule::Words { expected, found }));
            }
            let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
            *word = &rest[..end];
            rest = rest[end..].trim_start();
        }
        Ok((words, rest))
    }

    /// A finite number.
    pub(crate) fn number(&self, what: &'static str, word: &str) -> Result<f64> {
        let number: f64 = self.parsed(what, word, "a number")?;
        if !number.is_finite() {
            return Err(self.broken(FormatRule::NotFinite { what, found: number }));
        }
        Ok(number)
    }

    /// Finite numbers.
    pub(crate) fn numbers<const N: usize>(&self, what: &'static str, words: [&str; N]) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for (number, word) in numbers.iter_mut().zip(words) {
            *number = self.number(what, word)?;
        }
        Ok(numbers)
    }

    /// A word as what it should be.
    pub(crate) fn parsed<T: std::str::FromStr>(
        &self,
        what: &'static str,
        word: &str,
        expected: &'static str,
    ) -> Result<T> {
        const SHOWN: usize = 40;
        word.parse().map_err(|_| {
            self.broken(FormatRule::Number { what, found: word.chars().take(SHOWN).collect(), expected })
        })
    }
}
