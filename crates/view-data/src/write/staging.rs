//! A folder that is filled beside its target and takes the target's name when it is complete.

use super::{WriteRule, broken, make_folder};
use crate::{Error, Result};
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::path::{Path, PathBuf};

/// In temporary folders, the file that the process which fills them has locked.
const LOCK: &str = ".lock";

/// A temporary folder beside a target. [`Staging::finish`] renames it to the target, so nobody sees half of its content. Dropped
/// without `finish`, it is removed; if its process was killed, the next [`Staging::create`] for the same target removes it.
#[derive(Debug)]
pub struct Staging {
    target: PathBuf,
    /// Where the files lie until the end; empty once they have been moved.
    folder: PathBuf,
    /// Says that this process lives and its temporary folder is in use.
    _lock: Option<File>,
}

impl Staging {
    /// Makes the temporary folder. The target must not exist, or be an empty folder.
    ///
    /// # Errors
    /// If the target holds something, or no folder can be made beside it.
    pub fn create(target: &Path) -> Result<Self> {
        let name = target.file_name().ok_or_else(|| broken(target, WriteRule::NoName))?;
        let occupied = match std::fs::read_dir(target) {
            Ok(mut entries) => entries.next().is_some(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => false,
            Err(source) => return Err(Error::Read { path: target.to_path_buf(), source }),
        };
        if occupied {
            return Err(broken(target, WriteRule::Occupied));
        }
        let mut temporary = OsString::from(".");
        temporary.push(name);
        temporary.push(format!(".{}.tmp", std::process::id()));
        let folder = target.with_file_name(temporary);
        remove_left_behind(target, name);
        make_folder(&folder)?;
        let lock = folder.join(LOCK);
        let lock = gs_scene::lock_file(&lock).map_err(|source| {
            broken(&lock, WriteRule::File(gs_scene::Error::Io { action: "lock", path: lock.clone(), source }))
        })?;
        Ok(Self { target: target.to_path_buf(), folder, _lock: lock })
    }

    /// The temporary folder, to be filled.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What it will be called.
    #[must_use]
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Gives the folder its name.
    ///
    /// # Errors
    /// If something has come to lie at the target.
    pub fn finish(mut self) -> Result<()> {
        // Where it cannot be removed it stays, and does no harm.
        let _ = std::fs::remove_file(self.folder.join(LOCK));
        // An empty folder may be there; a rename does not replace one everywhere.
        let _ = std::fs::remove_dir(&self.target);
        std::fs::rename(&self.folder, &self.target)
            .map_err(|source| broken(&self.target, WriteRule::Move(source)))?;
        self.folder = PathBuf::new();
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.folder.as_os_str().is_empty() {
            // There is nobody to tell; the name says that it is temporary.
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }
}

/// Removes temporary folders of this target whose processes were killed: nobody holds their locks.
fn remove_left_behind(target: &Path, name: &OsStr) {
    let above = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let prefix = format!(".{}.", name.to_string_lossy());
    for entry in std::fs::read_dir(above).into_iter().flatten().flatten() {
        let found = entry.file_name().to_string_lossy().into_owned();
        let id = found.strip_prefix(&prefix).and_then(|rest| rest.strip_suffix(".tmp"));
        let is_ours = id.is_some_and(|id| !id.is_empty() && id.bytes().all(|digit| digit.is_ascii_digit()));
        let lock = entry.path().join(LOCK);
        // What cannot be removed is no worse than before.
        if is_ours
            && lock.is_file()
            && let Ok(Some(_held)) = gs_scene::lock_file(&lock)
        {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}
