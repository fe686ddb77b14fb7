//! COLMAP's sparse models, text or binary: world-to-camera poses with OpenCV axes, quaternions with w first, pixel
//! centres at +0.5, all as in this crate.

mod cameras;
mod model;
mod pictures;

use crate::files::{broken, folder_name, name_frames};
use crate::points::PointSource;
use crate::{Dataset, Dropped, Error, Format, FormatRule, Frame, Observation, Place, Result, ScenePoint};
use glam::{DMat3, DVec2};
use model::ModelImage;
use pictures::Pictures;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

pub(crate) use model::ModelFiles;

/// Where models lie, from a scene's folder; the first that there is, is taken.
const PLACES: [&str; 6] = ["", "sparse/0", "sparse", "0", "colmap/sparse/0", "colmap/sparse"];

/// Opens a sparse model of COLMAP: `path` is the scene's folder (with the model in it, in `sparse/0`, `sparse` or
/// `colmap/sparse/0`) or the model's. Binary files are preferred where text lies beside them.
///
/// Pictures are looked for by the names in the model, in `images`, `images_2`, `images_4`, `images_8`, `input` and the
/// folder itself, of the scene's folder or those above the model's; one with another extension is taken too.
/// Frames are sorted by image name, which is the order in which evaluation indices count. Poses keep the model's
/// world and scale.
///
/// # Errors
/// If there is no model, a file cannot be read or breaks a rule of the format, or the model has no images. The message
/// names file, line or byte, and rule.
pub fn open_colmap(path: &Path) -> Result<Dataset> {
    let files = find_model(path).ok_or_else(|| crate::open::no_layout(path, Some(Format::Colmap)))?;
    let cameras = files.cameras()?;
    let mut images: Vec<(ModelImage, usize)> = Vec::new();
    let mut names = HashSet::new();
    let check = |image: ModelImage, broken: &dyn Fn(FormatRule) -> Error| {
        if !cameras.contains_key(&image.camera) {
            return Err(broken(FormatRule::NoCamera { camera: image.camera, image: image.name }));
        }
        if !names.insert(image.name.clone()) {
            return Err(broken(FormatRule::Duplicate { what: "image name", found: image.name }));
        }
        let position = images.len();
        images.push((image, position));
        Ok(())
    };
    files.images(check, None)?;
    if images.is_empty() {
        return Err(broken(&files.path("images"), FormatRule::NoFrames { hint: String::new() }));
    }
    images.sort_by(|(a, _), (b, _)| a.name.cmp(&b.name));

    let mut pictures = Pictures::new(&files.folder, path);
    let mut frames = Vec::with_capacity(images.len());
    for (image, _) in &images {
        let axes = DMat3::from_quat(image.rotation).transpose();
        frames.push(Frame {
            name: String::new(),
            time: None,
            image: pictures.find(&image.name),
            depth: None,
            mask_path: None,
            lens: cameras[&image.camera],
            axes,
            position: -(axes * image.translation),
        });
    }
    name_frames(&mut frames, images.iter().map(|(image, _)| image.name.as_str()));

    let mut dropped: Vec<Dropped> = Vec::new();
    for frame in frames.iter().filter(|frame| frame.image.is_missing()) {
        dropped.push(Dropped::missing_picture(frame));
    }
    for name in pictures.unregistered(images.iter().map(|(image, _)| image.name.as_str())) {
        dropped.push(Dropped::new(name, "not registered: the model has no pose for this picture"));
    }
    dropped.extend(unread_files(&files.folder));

    let mut position_of = vec![0; images.len()];
    for (position, (_, in_file)) in images.iter().enumerate() {
        position_of[*in_file] = position;
    }
    let root = pictures.root();
    Ok(Dataset {
        name: folder_name(&root),
        file: files.path("images"),
        root,
        format: Format::Colmap,
        frames,
        dropped,
        depth_percentiles: None,
        url: None,
        applied_transform: None,
        offset: None,
        applied_scale: None,
        points: files.path("points3D").is_file().then_some(PointSource::Colmap { files, position_of }),
    })
}

/// Whether a model lies at a path.
pub(crate) fn is_there(path: &Path) -> bool {
    find_model(path).is_some()
}

fn find_model(path: &Path) -> Option<ModelFiles> {
    PLACES.iter().find_map(|place| ModelFiles::find(&path.join(place)))
}

/// What else COLMAP may have written there.
fn unread_files(folder: &Path) -> Vec<Dropped> {
    let mut unread = Vec::new();
    for name in ["rigs", "frames"] {
        for extension in ["bin", "txt"] {
            let file = format!("{name}.{extension}");
            if folder.join(&file).is_file() {
                unread.push(Dropped::new(file, "not needed: the images have poses of their own"));
            }
        }
    }
    if folder.file_name().is_some_and(|name| name == "0") {
        let others = (1..).map(|i| folder.with_file_name(format!("{i}")));
        for other in others.take_while(|other| ModelFiles::find(other).is_some()) {
            let key = other.display().to_string();
            unread.push(Dropped::new(key, "another model with a world of its own; open it by its path"));
        }
    }
    unread
}

/// Reads the points of a model, with the frames that see them; `position_of` takes the place of an image in the file
/// to the position of its frame. Sightings of points that the file of points lacks (somebody filtered it) are left out.
pub(crate) fn read_points(files: &ModelFiles, position_of: &[usize]) -> Result<Vec<ScenePoint>> {
    let (ids, mut points): (Vec<_>, Vec<_>) = files.points()?.into_iter().unzip();
    let index: HashMap<u64, usize> = ids.into_iter().enumerate().map(|(i, id)| (id, i)).collect();
    if index.len() != points.len() {
        let rule = FormatRule::Duplicate { what: "a point id", found: String::new() };
        return Err(Error::Format { path: files.path("points3D"), place: Place::Whole, rule });
    }
    let mut sight = |image: usize, pixel: DVec2, id: u64| {
        // The file may have changed since it was opened.
        let Some(&frame) = position_of.get(image) else { return };
        if let Some(&point) = index.get(&id)
            && pixel.is_finite()
        {
            points[point].observations.push(Observation { frame, pixel });
        }
    };
    files.images(|_, _| Ok(()), Some(&mut sight))?;
    Ok(points)
}

/// The folders in which the pictures of a model may lie.
pub(super) fn picture_roots(model: &Path, path: &Path) -> Vec<PathBuf> {
    let mut roots = vec![path.to_path_buf()];
    // `.` has no parent: its full path does.
    let full = std::fs::canonicalize(model).unwrap_or_else(|_| model.to_path_buf());
    let above: Vec<&Path> = full.ancestors().skip(1).take(3).collect();
    let is_nested =
        above.get(1).is_some_and(|folder| folder.file_name().is_some_and(|name| name == "colmap"));
    roots.extend(above.iter().take(if is_nested { 3 } else { 2 }).map(|folder| folder.to_path_buf()));
    roots
}
