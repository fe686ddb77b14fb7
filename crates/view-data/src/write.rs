//! Writes data sets in common layouts.

mod colmap;
mod error;
mod nerfstudio;
mod picture;
mod posed;
mod replica;
mod samples;
mod staging;

use crate::{Error, Result};
use gs_scene::{Lens, View};
use std::path::{Path, PathBuf};

pub use error::WriteRule;
pub use picture::PictureFormat;
pub use posed::{PosedFrame, write_posed};
pub use staging::Staging;

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
    staging: Staging,
    pictures: PictureFormat,
    frames: Vec<String>,
    body: Body,
    depth_out_of_range: u64,
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
        let staging = Staging::create(target)?;
        let (pictures, body, folders): (_, _, &[&str]) = match layout {
            Layout::Nerfstudio => (pictures, Body::Nerfstudio(Default::default()), &["images", "depth"]),
            Layout::Colmap => (pictures, Body::Colmap(colmap::Model::new(false)), &["images", "sparse/0"]),
            Layout::ColmapText => (pictures, Body::Colmap(colmap::Model::new(true)), &["images", "sparse/0"]),
            Layout::Replica => (PictureFormat::Jpeg, Body::Replica(Default::default()), &["results"]),
        };
        for sub_folder in folders {
            make_folder(&staging.folder().join(sub_folder))?;
        }
        Ok(Self { staging, pictures, frames: Vec::new(), body, depth_out_of_range: 0 })
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
            return Err(broken(self.staging.target(), WriteRule::FrameName { name: name.to_owned() }));
        }
        if lens.model.radial_tangential().is_none() {
            return Err(broken(self.staging.target(), WriteRule::LensModel { frame: name.to_owned() }));
        }
        let frame = FrameToWrite {
            view,
            lens,
            index: self.frames.len(),
            folder: self.staging.folder(),
            target: self.staging.target(),
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
    pub fn finish(self) -> Result<Written> {
        let target = self.staging.target();
        if self.frames.is_empty() {
            return Err(broken(target, WriteRule::Empty));
        }
        let folder = self.staging.folder();
        match &self.body {
            Body::Nerfstudio(transforms) => transforms.finish(folder)?,
            Body::Colmap(model) => model.finish(folder)?,
            Body::Replica(trajectory) => trajectory.finish(folder, target)?,
        }
        let (folder, frames) = (target.to_path_buf(), self.frames.len());
        self.staging.finish()?;
        Ok(Written { folder, frames, depth_out_of_range: self.depth_out_of_range })
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
