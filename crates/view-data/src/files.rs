//! Reading text and binary files piece by piece, with errors that say where.

mod binary;
mod lines;
mod names;

pub(crate) use binary::Binary;
pub(crate) use lines::{Line, Lines};
pub(crate) use names::{folder_name, name_frames};

use crate::{Error, FormatRule, Place};
use std::path::Path;

/// The error of a rule that a file breaks as a whole.
pub(crate) fn broken(path: &Path, rule: FormatRule) -> Error {
    Error::Format { path: path.to_path_buf(), place: Place::Whole, rule }
}

/// The error of a file or folder that the system does not give.
pub(crate) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_path_buf();
    move |source| Error::Read { path: path.clone(), source }
}
