//! Reading text and binary files piece by piece, with errors that say where.

mod binary;
mod lines;
mod names;

pub(crate) use binary::Binary;
pub(crate) use lines::{Line, Lines};
pub(crate) use names::{folder_name, name_frames};

use crate::{Error, FormatRule, Place};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// The largest file that is read into memory, bytes: above any picture of the most pixels that a view may have, and any list of frames.
pub(crate) const LARGEST: u64 = 1 << 30;

/// Opens a file, and nothing else: a FIFO would be waited for, and some devices never end.
pub(crate) fn open(path: &Path) -> std::io::Result<File> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::new(ErrorKind::InvalidInput, "it is no regular file"));
    }
    File::open(path)
}

/// The bytes of a file of at most [`LARGEST`].
pub(crate) fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    let file = open(path)?;
    let mut bytes = Vec::new();
    check_length(file.metadata()?.len())?;
    file.take(LARGEST).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// An error if so many bytes are more than is read into memory.
pub(crate) fn check_length(bytes: u64) -> std::io::Result<()> {
    if bytes > LARGEST {
        let rule = format!("it has {bytes} bytes, expected at most {LARGEST}");
        return Err(std::io::Error::new(ErrorKind::FileTooLarge, rule));
    }
    Ok(())
}

/// The error of a rule that a file breaks as a whole.
pub(crate) fn broken(path: &Path, rule: FormatRule) -> Error {
    Error::Format { path: path.to_path_buf(), place: Place::Whole, rule }
}

/// The error of a file or folder that the system does not give.
pub(crate) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_path_buf();
    move |source| Error::Read { path: path.clone(), source }
}
