//! Writes data sets in common layouts.

mod colmap;
mod error;
mod nerfstudio;
mod picture;
mod replica;
mod samples;

use crate::{Error, Result};
use gs_scene::{Lens, View};
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::path::{Path, PathBuf};

pub use error::WriteRule;
pub use picture::PictureFormat;

/// A layout that data sets are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// `transforms.json`, `images/`, and `depth/` as 32-bit EXR: exact.
    Nerfstudio,
    /// `images/` and `sparse/0/{cameras,images,points3D}.bin`. Its points are samples of the depth; the depth itself has no
    /// place in it.
    Colmap,
    /// The same as text.
    ColmapText,
    /// Replica as NICE-SLAM lays it out: `traj.txt` and `results/`, with `cam_params.json` in the parent folder. Depth is
    /// 16 bits of 1/6553.5 m: what is beyond 10 m is lost, and counted in [`Written`].
    Replica,
}

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The folder of the scene.
    pub folder: PathBuf,
    /// How many frames.
    pub frames: usize,
    /// Pixels whose depth the layout cannot hold (written as 0, no measurement).
    pub depth_out_of_range: u64,
}

/// Writes a data set frame by frame, so that no more than one is in memory.
///
/// Everything goes to a folder beside the target, which takes the target's name at [`DatasetWriter::finish`]: nobody sees half a
/// data set. Dropped without `finish`, the writer removes what it wrote.
#[derive(Debug)]
pub struct DatasetWriter {
    target: PathBuf,
    /// Where the files lie until the end; empty once they have been moved.
    folder: PathBuf,
    pictures: PictureFormat,
    frames: Vec<String>,
    body: Body,
    depth_out_of_range: u64,
    /// Says that this process lives and its temporary folder is in use.
    _lock: Option<File>,
}

/// In temporary folders, the file that the process which fills them has locked.
const LOCK: &str = ".lock";

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

/// What a layout gathers on the way.
#[derive(Debug)]
enum Body {
    Nerfstudio(nerfstudio::Transforms),
    Colmap(colmap::Model),
    Replica(replica::Trajectory),
}

impl DatasetWriter {
    /// Begins a data set in the folder `target`, which must not exist, or be empty. The Replica layout has JPEG pictures
    /// whatever `pictures` says.
    ///
    /// # Errors
    /// If the target holds something, or no folder can be made beside it.
    pub fn create(target: &Path, layout: Layout, pictures: PictureFormat) -> Result<Self> {
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
        let (pictures, body, folders): (_, _, &[&str]) = match layout {
            Layout::Nerfstudio => (pictures, Body::Nerfstudio(Default::default()), &["images", "depth"]),
            Layout::Colmap => (pictures, Body::Colmap(colmap::Model::new(false)), &["images", "sparse/0"]),
            Layout::ColmapText => (pictures, Body::Colmap(colmap::Model::new(true)), &["images", "sparse/0"]),
            Layout::Replica => (PictureFormat::Jpeg, Body::Replica(Default::default()), &["results"]),
        };
        for sub_folder in folders {
            make_folder(&folder.join(sub_folder))?;
        }
        let lock = folder.join(LOCK);
        let lock = gs_scene::lock_file(&lock).map_err(|source| {
            broken(&lock, WriteRule::File(gs_scene::Error::Io { action: "lock", path: lock.clone(), source }))
        })?;
        let (target, frames) = (target.to_path_buf(), Vec::new());
        Ok(Self { target, folder, pictures, frames, body, depth_out_of_range: 0, _lock: lock })
    }

    /// Writes a frame. The picture and its depth are as `lens` sees them, distortion included; the pose is the view's, its
    /// intrinsics the lens's.
    ///
    /// # Errors
    /// If a file cannot be written, a name occurs twice or is not a plain file name, or the layout cannot hold the lens.
    pub fn add(&mut self, view: &View, lens: &Lens) -> Result<()> {
        let name = view.name();
        let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', '\0', '\n']);
        if !plain || self.frames.iter().any(|other| other == name) {
            return Err(broken(&self.target, WriteRule::FrameName { name: name.to_owned() }));
        }
        if lens.model.radial_tangential().is_none() {
            return Err(broken(&self.target, WriteRule::LensModel { frame: name.to_owned() }));
        }
        let frame = FrameToWrite {
            view,
            lens,
            index: self.frames.len(),
            folder: &self.folder,
            target: &self.target,
            pictures: self.pictures,
        };
        self.depth_out_of_range += match &mut self.body {
            Body::Nerfstudio(transforms) => transforms.add(&frame)?,
            Body::Colmap(model) => model.add(&frame)?,
            Body::Replica(trajectory) => trajectory.add(&frame)?,
        };
        self.frames.push(name.to_owned());
        Ok(())
    }

    /// Writes what describes all frames, and gives the folder its name.
    ///
    /// # Errors
    /// If there are no frames, a file cannot be written, or something has come to lie at the target.
    pub fn finish(mut self) -> Result<Written> {
        if self.frames.is_empty() {
            return Err(broken(&self.target, WriteRule::Empty));
        }
        match &self.body {
            Body::Nerfstudio(transforms) => transforms.finish(&self.folder)?,
            Body::Colmap(model) => model.finish(&self.folder)?,
            Body::Replica(trajectory) => trajectory.finish(&self.folder, &self.target)?,
        }
        // Where it cannot be removed it stays, and does no harm.
        let _ = std::fs::remove_file(self.folder.join(LOCK));
        // An empty folder may be there; a rename does not replace one everywhere.
        let _ = std::fs::remove_dir(&self.target);
        std::fs::rename(&self.folder, &self.target)
            .map_err(|source| broken(&self.target, WriteRule::Move(source)))?;
        self.folder = PathBuf::new();
        let (folder, frames) = (self.target.clone(), self.frames.len());
        Ok(Written { folder, frames, depth_out_of_range: self.depth_out_of_range })
    }
}

impl Drop for DatasetWriter {
    fn drop(&mut self) {
        if !self.folder.as_os_str().is_empty() {
            // There is nobody to tell; the name says that it is temporary.
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }
}

/// A frame on its way into a layout.
struct FrameToWrite<'a> {
    view: &'a View,
    lens: &'a Lens,
    index: usize,
    folder: &'a Path,
    /// What errors name.
    target: &'a Path,
    pictures: PictureFormat,
}

impl FrameToWrite<'_> {
    /// Writes the picture under `images/` and returns its path relative to the folder.
    fn write_picture(&self) -> Result<String> {
        let path = format!("images/{}.{}", self.view.name(), self.pictures.extension());
        picture::write(self.view.image(), &self.folder.join(&path), self.pictures)?;
        Ok(path)
    }
}

pub(crate) fn broken(path: &Path, rule: WriteRule) -> Error {
    Error::Write { path: path.to_path_buf(), rule }
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(|source| broken(path, WriteRule::MakeFolder(source)))
}

/// Writes a small text or binary file.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    gs_scene::write_atomically(path, |writer| writer.write_all(bytes))
        .map_err(|source| broken(path, WriteRule::File(source)))
}
