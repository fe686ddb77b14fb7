//! Folders that one process at a time may write into.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Result};
use std::path::Path;

/// Keeps other processes out for as long as the returned file lives; `None` if one is in already. Where the file system has no locks,
/// nobody is kept out. The file stays: the lock is on it, it is not the lock.
///
/// # Errors
/// If the file cannot be made, or the system refuses.
pub fn lock_file(path: &Path) -> Result<Option<File>> {
    let file = File::create(path)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) if error.kind() != ErrorKind::Unsupported => Err(error),
        _ => Ok(Some(file)),
    }
}
