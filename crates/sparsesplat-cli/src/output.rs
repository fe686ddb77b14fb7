//! Files that commands write, and what they must not be written over.

use crate::arguments::Common;
use crate::failure::{Failure, OrFail, Outcome};
use crate::summary;
use anyhow::Context;
use gs_scene::{Gaussians, links};
use serde::Serialize;
use splat_formats::{Encoder, Format, Scene};
use std::collections::HashMap;
use std::ffi::OsStr;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Files that a command is to write, each with the argument that names it.
pub(crate) struct Outputs<'a>(Vec<(&'static str, &'a Path)>);

impl<'a> Outputs<'a> {
    /// What every command may write.
    pub(crate) fn of(common: &'a Common) -> Self {
        Self(Vec::new()).with("--json", common.json.as_ref())
    }

    /// One more, if it is asked for.
    pub(crate) fn with(mut self, argument: &'static str, path: Option<&'a PathBuf>) -> Self {
        self.0.extend(path.map(|path| (argument, path.as_path())));
        self
    }

    /// Makes sure, before long work, that each can be written and that none takes the place of another. From here on, what commands say
    /// goes to standard error if a result takes standard output.
    pub(crate) fn check(self) -> Outcome<Self> {
        let mut places: HashMap<Place, &str> = HashMap::new();
        for &(argument, path) in &self.0 {
            let place = Place::of(path);
            match place {
                Place::StandardOutput => summary::leave_standard_output(),
                Place::Device => continue,
                Place::File(_) => check_file(path)?,
            }
            if let Some(other) = places.insert(place, argument) {
                return Err(Failure::input(format!(
                    "{}: is given as {other} and as {argument}: one would replace the other, give each a path of its own",
                    path.display()
                )));
            }
        }
        Ok(self)
    }

    /// Refuses to write over a file that the command reads.
    pub(crate) fn spare<'b>(&self, inputs: impl IntoIterator<Item = &'b Path>) -> Outcome {
        let mut places: HashMap<Place, (&str, &Path)> = HashMap::new();
        for &(argument, path) in &self.0 {
            places.insert(Place::of(path), (argument, path));
        }
        for input in inputs {
            let place = Place::of(input);
            if let (Place::File(_), Some((argument, path))) = (&place, places.get(&place)) {
                return Err(Failure::input(format!(
                    "{argument} {}: is a file that this command reads, and would be replaced: give another path",
                    path.display()
                )));
            }
        }
        Ok(())
    }
}

/// Where a path leads.
#[derive(Debug, PartialEq, Eq, Hash)]
enum Place {
    /// `-`, or a name that the system has for standard output.
    StandardOutput,
    /// What keeps nothing, such as /dev/null: any number of results may go there.
    Device,
    /// A file, a FIFO or a folder, whether it is there or not, by the one name that it has.
    File(PathBuf),
}

impl Place {
    fn of(path: &Path) -> Self {
        const NAMES: [&str; 3] = ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"];
        let steps = links(path);
        if path == Path::new("-") || steps.iter().any(|step| NAMES.iter().any(|name| step == Path::new(name)))
        {
            return Self::StandardOutput;
        }
        #[cfg(unix)]
        if let Ok(found) = fs::metadata(path)
            && std::os::unix::fs::FileTypeExt::is_char_device(&found.file_type())
        {
            return Self::Device;
        }
        let last = steps.last().map_or(path, PathBuf::as_path);
        let absolute = fs::canonicalize(last).or_else(|_| {
            let folder = fs::canonicalize(folder_of(last))?;
            Ok::<_, io::Error>(folder.join(last.file_name().unwrap_or(OsStr::new(""))))
        });
        Self::File(absolute.unwrap_or_else(|_| last.to_path_buf()))
    }
}

/// Whether a path is a file or could be: neither standard output nor a device or a FIFO.
pub(crate) fn is_file(path: &Path) -> bool {
    matches!(Place::of(path), Place::File(_)) && fs::metadata(path).map_or(true, |found| found.is_file())
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

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
fn check_file(path: &Path) -> Outcome {
    if path.is_dir() {
        return Err(Failure::input(format!("{}: is a folder, expected the name of a file", path.display())));
    }
    let target = links(path).pop().unwrap_or_else(|| path.to_path_buf());
    match fs::metadata(&target) {
        // Into a FIFO or a device nothing is written to try it.
        Ok(found) if !found.is_file() => Ok(()),
        _ => check_folder(folder_of(&target)),
    }
}

/// Writes a file all or nothing; into standard output, a device or a FIFO directly.
fn write(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Outcome {
    if Place::of(path) != Place::StandardOutput {
        return gs_scene::write_atomically(path, fill).or_work();
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    fill(&mut out).and_then(|()| out.flush()).context("standard output: cannot write").or_work()
}

/// Writes text.
pub(crate) fn write_text(path: &Path, text: &str) -> Outcome {
    write(path, |out| out.write_all(text.as_bytes()))
}

/// Writes a value as JSON.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Outcome {
    write_text(path, &(to_json(value)? + "\n"))
}

/// Reads the format of a scene as an argument says it: by its extension.
pub(crate) fn parse_format(text: &str) -> Result<Format, String> {
    let names = || Format::ALL.map(Format::extension).join(", ");
    let named = |format: &Format| format.extension() == text;
    Format::ALL.into_iter().find(named).ok_or_else(|| format!("expected {}", names()))
}

/// The format that a scene is written in: by the extension of its file; PLY without one, as on standard output.
pub(crate) fn scene_format(path: &Path) -> Outcome<Format> {
    let name = links(path).pop().unwrap_or_else(|| path.to_path_buf());
    match [path, &name].into_iter().find_map(Format::of_path) {
        Some(format) => Ok(format),
        None if Place::of(path) == Place::StandardOutput || path.extension().is_none() => Ok(Format::Ply),
        None => Err(splat_formats::Error::Extension { path: path.to_path_buf() }).or_input(),
    }
}

/// Writes a scene; says first what its format does not keep.
pub(crate) fn write_scene(path: &Path, format: Format, gaussians: &Gaussians, say: impl Fn(&str)) -> Outcome {
    let encoder = Encoder::new(gaussians, format).or_work()?;
    for loss in encoder.losses() {
        say(&format!("{}: {loss}", named(path)));
    }
    write(path, |out| encoder.encode(out))
}

/// Reads a scene in any format, and warns of what else its file says.
pub(crate) fn read_scene(path: &Path) -> Outcome<Scene> {
    let scene = splat_formats::read_scene(path).or_input()?;
    for remark in &scene.remarks {
        summary::warn(&format!("{}: {remark}", path.display()));
    }
    Ok(scene)
}

/// How a path is called where it is said.
pub(crate) fn named(path: &Path) -> String {
    match Place::of(path) {
        Place::StandardOutput => "standard output".to_owned(),
        _ => path.display().to_string(),
    }
}

/// A value as JSON that people can read.
pub(crate) fn to_json(value: &impl Serialize) -> Outcome<String> {
    serde_json::to_string_pretty(value).or_work()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_one_place_whatever_it_is_called() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("deep")).unwrap();
        fs::write(path("deep/there"), b"").unwrap();
        assert_eq!(Place::of(&path("deep/there")), Place::of(&path("deep/../deep/there")));
        assert_eq!(Place::of(&path("deep/not")), Place::of(&path("deep/../deep/not")));
        assert_ne!(Place::of(&path("deep/not")), Place::of(&path("deep/there")));
        assert_eq!(Place::of(Path::new("-")), Place::StandardOutput);
        assert_ne!(Place::of(Path::new("./-")), Place::StandardOutput);
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_are_told() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        symlink("target", path("link")).unwrap();
        symlink("/dev/stdout", path("out")).unwrap();
        assert_eq!(Place::of(&path("link")), Place::of(&path("target")));
        assert_eq!(Place::of(&path("out")), Place::StandardOutput);
        assert_eq!(Place::of(Path::new("/dev/null")), Place::Device);

        fs::write(path("input"), b"").unwrap();
        symlink("input", path("other")).unwrap();
        let (null, other) = (PathBuf::from("/dev/null"), path("other"));
        let twice = Outputs(vec![("--a", &null), ("--b", &null)]);
        assert!(twice.check().is_ok());
        let over = Outputs(vec![("--a", &other)]);
        assert!(over.spare([path("input").as_path()]).is_err());
        assert!(over.spare([path("target").as_path()]).is_ok());
    }
}
