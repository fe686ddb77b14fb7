//! DL3DV-10K's folders: one per scene, named by its hash, with a `transforms.json` in nerfstudio's layout that
//! describes the full-size pictures, and smaller copies of them.

use crate::camera_row::{CameraRule, MAX_TRANSLATION};
use crate::scene_list::{SceneEntry, SceneList};
use crate::{Dataset, Dropped, Error, Format, Result, Scenes};
use std::path::{Path, PathBuf};

/// The rules of a DL3DV folder that can be broken; those of its `transforms.json` are [`crate::TransformsRule`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Dl3dvRule {
    /// Pictures without cameras.
    #[error("has pictures, but no transforms.json")]
    NoTransforms,
    /// No folder of pictures.
    #[error("has no folder of pictures (images, images_4 or images_8)")]
    NoPictureFolder,
    /// The folder of pictures has none of those that the list names.
    #[error("none of the {frames} pictures of transforms.json is in {folder}")]
    NoPictures {
        /// Frames of the list.
        frames: usize,
        /// The folder.
        folder: String,
    },
    /// A camera breaks a rule.
    #[error("{0}")]
    Camera(CameraRule),
}

/// Opens every scene of `path`, see [`list_dl3dv`]; a scene that breaks a rule is listed as dropped.
///
/// # Errors
/// As [`list_dl3dv`].
pub fn open_dl3dv(path: &Path) -> Result<Scenes> {
    Ok(list_dl3dv(path)?.open_all())
}

/// Lists the scenes of `path`: a scene's folder, a folder of them, or the root with `1K` to `11K` in which they are. A
/// scene has its `transforms.json` in its folder, or in `nerfstudio/` (the benchmark). Its name is that of the folder:
/// the hash by which evaluation indices know it.
///
/// Of several folders of pictures the one with the largest pictures is read: `images`, then `images_2` and so on.
///
/// # Errors
/// If nothing of that kind lies there, or a folder cannot be listed.
pub fn list_dl3dv(path: &Path) -> Result<SceneList> {
    let mut list = SceneList::new(Format::Dl3dv);
    // Without this a path such as `.` would have no name.
    let root =
        std::fs::canonicalize(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    if !add_scene(&root, &mut list) {
        for folder in sub_folders(&root)? {
            if !add_scene(&folder, &mut list) {
                for folder in sub_folders(&folder)? {
                    add_scene(&folder, &mut list);
                }
            }
        }
    }
    list.finish(path)
}

/// Whether a path is a scene with its folder of pictures, or holds folders named by 64 hexadecimal digits, itself or
/// one level below.
pub(crate) fn is_there(root: &Path) -> bool {
    let is_scene = |home: &Path| home.join("transforms.json").is_file() && picture_folder(home).is_some();
    if is_scene(root) || is_scene(&root.join("nerfstudio")) {
        return true;
    }
    let is_hash = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.len() == 64 && name.bytes().all(|byte| byte.is_ascii_hexdigit())
    };
    let folders = sub_folders(root).unwrap_or_default();
    folders
        .iter()
        .any(|folder| is_hash(folder) || sub_folders(folder).is_ok_and(|below| below.iter().any(is_hash)))
}

/// Takes a folder into the list if it is a scene, whole or not.
fn add_scene(folder: &Path, list: &mut SceneList) -> bool {
    let nested = folder.join("nerfstudio");
    let named = if folder.ends_with("nerfstudio") { folder.parent().unwrap_or(folder) } else { folder };
    let name = named.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let homes = [folder, nested.as_path()];
    if let Some(home) = homes.into_iter().find(|home| home.join("transforms.json").is_file()) {
        list.entries.push(SceneEntry { name, path: home.to_path_buf() });
        return true;
    }
    let Some(home) = homes.into_iter().find(|home| picture_folder(home).is_some()) else { return false };
    let error = Error::Dl3dv { path: home.to_path_buf(), frame: None, rule: Dl3dvRule::NoTransforms };
    list.dropped.push(Dropped::failed(name, &error));
    true
}

fn sub_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |source| Error::Read { path: folder.to_path_buf(), source };
    let entries = std::fs::read_dir(folder).map_err(unreadable)?;
    let paths: std::io::Result<Vec<_>> = entries.map(|entry| Ok(entry?.path())).collect();
    let mut folders: Vec<_> = paths.map_err(unreadable)?.into_iter().filter(|path| path.is_dir()).collect();
    folders.sort();
    Ok(folders)
}

/// The folder of pictures that are reduced least.
fn picture_folder(home: &Path) -> Option<PathBuf> {
    let reduction = |path: &PathBuf| {
        let name = path.file_name()?.to_str()?.strip_prefix("images")?;
        if name.is_empty() { Some(1) } else { name.strip_prefix('_')?.parse::<u32>().ok() }
    };
    let folders = sub_folders(home).unwrap_or_default().into_iter();
    folders.filter_map(|path| Some((reduction(&path)?, path))).min().map(|(_, path)| path)
}

/// Opens the scene whose `transforms.json` lies in `home`.
pub(crate) fn open_scene(home: &Path, name: &str) -> Result<Dataset> {
    let broken = |rule| Error::Dl3dv { path: home.to_path_buf(), frame: None, rule };
    let folder = picture_folder(home).ok_or_else(|| broken(Dl3dvRule::NoPictureFolder))?;
    let mut dataset = crate::nerfstudio::open_with_pictures_in(&home.join("transforms.json"), &folder)?;
    name.clone_into(&mut dataset.name);
    dataset.format = Format::Dl3dv;
    if dataset.present().is_empty() {
        let (frames, folder) = (dataset.frames.len(), folder.display().to_string());
        return Err(broken(Dl3dvRule::NoPictures { frames, folder }));
    }
    for frame in &dataset.frames {
        // World to camera, as in chunks, where the same limit holds.
        let translation = -(frame.axes.transpose() * frame.position);
        if let Some(found) = translation.to_array().into_iter().find(|entry| entry.abs() > MAX_TRANSLATION) {
            let rule = Dl3dvRule::Camera(CameraRule::Translation { found });
            return Err(Error::Dl3dv { path: home.to_path_buf(), frame: Some(frame.name.clone()), rule });
        }
    }
    Ok(dataset)
}
