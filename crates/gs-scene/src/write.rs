use crate::{Error, Result};
use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Symbolic links that are followed from one path: as many as Linux follows.
const MAX_LINKS: usize = 40;

/// Writes a file so that a reader never sees half of it: the content goes to a temporary file beside it, which then
/// takes its name. Missing parent folders are made. After an error the old file, if there was one, is still there.
///
/// A symbolic link stays, and what it points to is written. A device, a FIFO or a socket stays too: the content goes into it
/// at once, as there is nothing that a rename could replace.
///
/// # Errors
/// If a folder or file cannot be written, or `fill` fails.
pub fn write_atomically(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    write(path, false, fill)
}

/// As [`write_atomically`], and waits until the disk has the content before the file takes its name, and the name where the file system
/// can: what was written survives the end of the machine. This costs some milliseconds.
///
/// # Errors
/// As [`write_atomically`].
pub fn write_durably(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    write(path, true, fill)
}

fn write(path: &Path, durably: bool, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let fail = |action, path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::Io { action, path, source }
    };
    // Follows what the system itself would, such as /proc/self/fd/1, which is no path that could be read as a link.
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        return write_into(path, fill).map_err(fail("write", path));
    }
    let target = links(path).pop().unwrap_or_else(|| path.to_path_buf());
    if target.is_symlink() {
        // Links in a circle; the system's own error says so.
        fs::metadata(path).map_err(fail("write", path))?;
    }
    let file_name = target.file_name().ok_or_else(|| Error::Io {
        action: "write",
        path: path.to_path_buf(),
        source: std::io::Error::from(std::io::ErrorKind::InvalidFilename),
    })?;
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(fail("make the folder", folder))?;
    let written = (|| {
        let mut temporary = tempfile::Builder::new();
        temporary.prefix(file_name).suffix(".tmp");
        // What anybody may read by the process's mask: of itself a temporary file is its owner's alone.
        #[cfg(unix)]
        temporary.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut writer = BufWriter::with_capacity(1 << 20, temporary.tempfile_in(folder)?);
        fill(&mut writer)?;
        let temporary = writer.into_inner()?;
        if durably {
            temporary.as_file().sync_all()?;
        }
        temporary.persist(&target)?;
        // The name is the folder's. Windows opens no folder as a file, a folder may be writable and not readable, and some file systems
        // have no such call: the file is whole all the same.
        if durably && let Ok(folder) = fs::File::open(folder) {
            use std::io::ErrorKind::{InvalidInput, Unsupported};
            let synced = folder.sync_all();
            synced.or_else(|error| {
                if matches!(error.kind(), InvalidInput | Unsupported) { Ok(()) } else { Err(error) }
            })?;
        }
        Ok(())
    })();
    written.map_err(fail("write", path))
}

/// The path, and what symbolic links make of it, one step each; the last is no link, but need not exist.
#[must_use]
pub fn links(path: &Path) -> Vec<PathBuf> {
    let mut steps = vec![path.to_path_buf()];
    while let Some(last) = steps.last().filter(|_| steps.len() <= MAX_LINKS)
        && let Ok(to) = fs::read_link(last)
    {
        let next = last.parent().unwrap_or(Path::new("")).join(to);
        steps.push(next);
    }
    steps
}

fn write_into(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut writer = BufWriter::with_capacity(1 << 16, fs::OpenOptions::new().write(true).open(path)?);
    fill(&mut writer)?;
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/file.txt");
        write_durably(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"new")?;
            Err(std::io::Error::from(std::io::ErrorKind::StorageFull))
        });
        assert!(failed.unwrap_err().to_string().ends_with("file.txt: cannot write"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_has_the_permissions_of_any_other() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
        write_atomically(&ours, |w| w.write_all(b"x")).unwrap();
        fs::write(&plain, b"x").unwrap();
        let mode = |path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }

    #[test]
    fn two_writers_at_once_leave_one_whole_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomically(&path, |outer| {
            outer.write_all(b"outer")?;
            write_atomically(&path, |inner| inner.write_all(b"inner")).unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"inner");
            Ok(())
        })
        .unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"outer");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_that_is_a_file_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("plain"), b"").unwrap();
        assert!(write_atomically(&folder.path().join("plain/x.ply"), |_| Ok(())).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_their_targets_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("deep")).unwrap();
        fs::write(path("deep/target"), b"old").unwrap();
        std::os::unix::fs::symlink("deep/target", path("second")).unwrap();
        std::os::unix::fs::symlink("second", path("first")).unwrap();
        std::os::unix::fs::symlink("deep/new", path("dangling")).unwrap();
        std::os::unix::fs::symlink("circle", path("circle")).unwrap();
        assert_eq!(links(&path("first")), [path("first"), path("second"), path("deep/target")]);
        write_atomically(&path("first"), |w| w.write_all(b"new")).unwrap();
        write_atomically(&path("dangling"), |w| w.write_all(b"made")).unwrap();
        assert_eq!(fs::read(path("deep/target")).unwrap(), b"new");
        assert_eq!(fs::read(path("deep/new")).unwrap(), b"made");
        for link in ["first", "second", "dangling"] {
            assert!(path(link).is_symlink(), "{link}");
        }
        assert!(write_atomically(&path("circle"), |w| w.write_all(b"x")).is_err());
        assert!(path("circle").is_symlink());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_and_fifos_stay_what_they_are() {
        use std::os::unix::fs::FileTypeExt;
        write_atomically(Path::new("/dev/null"), |w| w.write_all(b"nothing")).unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        let full = write_atomically(Path::new("/dev/full"), |w| w.write_all(b"too much")).unwrap_err();
        assert_eq!(full.to_string(), "/dev/full: cannot write");

        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("fifo");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status().unwrap();
        assert!(made.success());
        let reader = std::thread::spawn({
            let fifo = fifo.clone();
            move || fs::read(fifo).unwrap()
        });
        write_atomically(&fifo, |w| w.write_all(b"through")).unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert!(fs::metadata(&fifo).unwrap().file_type().is_fifo());
    }
}
