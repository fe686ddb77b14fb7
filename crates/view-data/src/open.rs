//! Opens a data set of unknown layout, which is recognised by its files.

use crate::{
    Dataset, Dropped, Error, Format, Result, open_chunks, open_colmap, open_dl3dv, open_nerfstudio,
    open_re10k, open_replica, open_scannet, open_tum,
};
use std::path::{Path, PathBuf};

/// Scenes below a folder.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Scenes {
    /// The scenes in the order of their names.
    pub scenes: Vec<Dataset>,
    /// Scenes that cannot be read, and why.
    pub dropped: Vec<Dropped>,
}

/// Opens one scene: in the layout `format`, or, without, in the first layout of [`Format::ALL`] whose files lie there. A folder that
/// holds the folder of one scene will do.
///
/// # Errors
/// If no layout fits (the error says what was looked for), `path` holds more than one scene, or the files break a
/// rule of their format.
pub fn open(path: &Path, format: Option<Format>) -> Result<Dataset> {
    let mut scenes = match recognised(path, format) {
        Ok(format) => open_as(path, format)?,
        // A folder around scenes: one is what is meant, of several the error has the names.
        Err(error @ (Error::NoLayout { .. } | Error::NoPoses { .. })) if path.is_dir() => {
            open_all(path, format).map_err(|_| error)?
        }
        Err(error) => return Err(error),
    };
    if scenes.scenes.len() == 1 {
        return Ok(scenes.scenes.remove(0));
    }
    let names = scenes.scenes.into_iter().map(|scene| scene.name).collect();
    Err(Error::NotOneScene { path: path.to_path_buf(), names, dropped: scenes.dropped })
}

/// Opens all scenes of a folder: the folder itself if a layout fits it, else every sub-folder that one fits, in the
/// order of names. Scenes that cannot be read are listed as dropped.
///
/// # Errors
/// If the folder cannot be listed, or no layout fits it or a sub-folder.
pub fn open_all(root: &Path, format: Option<Format>) -> Result<Scenes> {
    match recognised(root, format) {
        Ok(format) => return open_as(root, format),
        Err(error) if !root.is_dir() => return Err(error),
        Err(_) => {}
    }
    let unreadable = |source| Error::Read { path: root.to_path_buf(), source };
    let mut folders: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(root).map_err(unreadable)? {
        folders.push(entry.map_err(unreadable)?.path());
    }
    folders.sort();
    let mut all = Scenes::default();
    let mut fits_none = true;
    for folder in folders.iter().filter(|folder| folder.is_dir()) {
        let Ok(format) = recognised(folder, format) else { continue };
        fits_none = false;
        match open_as(folder, format) {
            Ok(found) => {
                all.scenes.extend(found.scenes);
                all.dropped.extend(found.dropped);
            }
            Err(error) => all.dropped.push(Dropped::new(folder.display().to_string(), chain(&error))),
        }
    }
    if fits_none { Err(no_layout(root, format)) } else { Ok(all) }
}

fn open_as(path: &Path, format: Format) -> Result<Scenes> {
    let mut found = read_as(path, format)?;
    found.scenes = found.scenes.into_iter().map(Dataset::near_origin).collect();
    Ok(found)
}

fn read_as(path: &Path, format: Format) -> Result<Scenes> {
    let one = |scene: Result<Dataset>| Ok(Scenes { scenes: vec![scene?], dropped: Vec::new() });
    match format {
        Format::Nerfstudio => one(open_nerfstudio(path)),
        Format::Chunk => open_chunks(path),
        Format::Dl3dv => open_dl3dv(path),
        Format::Re10k => open_re10k(path),
        Format::Colmap => one(open_colmap(path)),
        Format::Replica => one(open_replica(path)),
        Format::Tum => one(open_tum(path)),
        Format::ScanNet => one(open_scannet(path)),
    }
}

/// The format that was asked for, if its files lie there, or the first that fits.
fn recognised(path: &Path, format: Option<Format>) -> Result<Format> {
    std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    let fitting = candidates(format).find(|&format| fits(path, format));
    fitting.ok_or_else(|| no_layout(path, format))
}

fn candidates(format: Option<Format>) -> impl Iterator<Item = Format> {
    Format::ALL.into_iter().filter(move |candidate| format.is_none_or(|format| format == *candidate))
}

/// Whether the files of a format lie at a path. None is opened.
fn fits(path: &Path, format: Format) -> bool {
    match format {
        Format::Nerfstudio => {
            crate::nerfstudio::file_in(path).is_file()
                || path.is_file() && path.extension().is_some_and(|extension| extension == "json")
        }
        Format::Chunk => crate::chunk::is_there(path),
        Format::Dl3dv => crate::dl3dv::is_there(path),
        Format::Re10k => crate::re10k::is_there(path),
        Format::Colmap => crate::colmap::is_there(path),
        Format::Replica => crate::replica::is_there(path),
        Format::Tum => crate::tum::is_there(path),
        Format::ScanNet => crate::scannet::is_there(path),
    }
}

/// What [`fits`] looks for.
fn looked_for(format: Format) -> &'static str {
    match format {
        Format::Nerfstudio => "transforms.json or transforms_train.json",
        Format::Colmap => "cameras and images (.bin or .txt) in ., sparse/0, sparse or colmap/sparse/0",
        Format::Replica => "traj.txt and results/",
        Format::Tum => "rgb.txt and groundtruth.txt",
        Format::ScanNet => "color/ and pose/",
        Format::Chunk => "a .torch file, or .torch files in ., test/ or train/",
        Format::Dl3dv => "transforms.json or nerfstudio/transforms.json in folders named by 64 hex digits",
        Format::Re10k => "camera files <key>.txt with a folder <key> beside them in ., test/ or train/",
    }
}

pub(crate) fn no_layout(path: &Path, format: Option<Format>) -> Error {
    let describe = |format: Format| format!("{format} ({})", looked_for(format));
    let looked_for = candidates(format).map(describe).collect();
    let path = path.to_path_buf();
    match Unposed::at(&path) {
        Some(found) => Error::NoPoses { path, found, looked_for },
        None => Error::NoLayout { path, looked_for },
    }
}

/// What lies where a data set should, and has no poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Unposed {
    /// So many pictures.
    Photographs(usize),
    /// A video.
    Video,
    /// Files packed into one.
    Archive,
}

impl Unposed {
    fn at(path: &Path) -> Option<Self> {
        const PICTURES: &[&str] = &["jpg", "jpeg", "png", "heic", "heif", "tif", "tiff", "dng", "webp"];
        const VIDEOS: &[&str] = &["mp4", "mov", "avi", "mkv", "webm", "m4v"];
        const ARCHIVES: &[&str] = &["zip", "tar", "gz", "tgz", "xz", "bz2", "zst", "7z", "rar"];
        let is = |path: &Path, known: &[&str]| {
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            path.is_file() && known.contains(&&*extension)
        };
        let files = |folder: &Path| -> Vec<PathBuf> {
            std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
        };
        let mut all = if path.is_dir() { files(path) } else { vec![path.to_path_buf()] };
        let count = |all: &[PathBuf], known| all.iter().filter(|path| is(path, known)).count();
        if count(&all, PICTURES) == 0 {
            all.extend(files(&path.join("images")));
        }
        match (count(&all, PICTURES), count(&all, VIDEOS), count(&all, ARCHIVES)) {
            (0, 0, 0) => None,
            (0, 0, _) => Some(Self::Archive),
            (0, _, _) => Some(Self::Video),
            (pictures, _, _) => Some(Self::Photographs(pictures)),
        }
    }
}

/// What it is, and what to do.
impl std::fmt::Display for Unposed {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Photographs(1) => {
                f.write_str("a picture, expected several with the poses of their cameras")
            }
            Self::Photographs(n) => {
                write!(f, "{n} pictures without the poses of their cameras, which have to be estimated first")
            }
            Self::Video => {
                f.write_str("a video without the poses of its camera, which have to be estimated first")
            }
            Self::Archive => f.write_str("an archive: unpack it, and give the folder"),
        }
    }
}

/// An error and its causes in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}
