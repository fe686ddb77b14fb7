//! Files that commands write.

use crate::failure::{Failure, OrFail, Outcome};
use anyhow::Context;
use serde::Serialize;
use std::fs;
use std::path::Path;

/// Makes sure, before long work, that files can be written into a folder; makes the folder.
pub(crate) fn check_folder(folder: &Path) -> Outcome {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let cannot = || format!("{}: cannot write into this folder", folder.display());
    fs::create_dir_all(folder).with_context(cannot).or_input()?;
    // It goes when it is dropped.
    tempfile::tempfile_in(folder).with_context(cannot).or_input()?;
    Ok(())
}

/// The same for a file.
pub(crate) fn check_file(path: &Path) -> Outcome {
    if path.is_dir() {
        return Err(Failure::input(format!("{}: is a folder, expected the name of a file", path.display())));
    }
    check_folder(path.parent().unwrap_or(Path::new("")))
}

/// Writes text, all or nothing.
pub(crate) fn write_text(path: &Path, text: &str) -> Outcome {
    gs_scene::write_atomically(path, |out| out.write_all(text.as_bytes())).or_work()
}

/// Writes a value as JSON.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Outcome {
    write_text(path, &(to_json(value)? + "\n"))
}

/// A value as JSON that people can read.
pub(crate) fn to_json(value: &impl Serialize) -> Outcome<String> {
    serde_json::to_string_pretty(value).or_work()
}
