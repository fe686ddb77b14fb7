//! ScanNet as its tool exports it: `color/0.jpg`, `depth/0.png`, `pose/0.txt`, `intrinsic/intrinsic_color.txt`.

use crate::files::broken;
use crate::trajectory::{dataset, frame, intrinsics_of_whole_centres, matrix_file, numbered, pose};
use crate::{
    Dataset, DepthFile, Dropped, Error, Format, FormatRule, ImageSource, Lens, LensModel, Place, Result,
};
use gs_scene::Intrinsics;
use std::path::{Path, PathBuf};

/// Metres per count of depth.
const DEPTH_UNIT: f64 = 0.001;

/// Opens a scene of ScanNet, exported frame by frame. Frames are in the order of their numbers.
///
/// `pose/N.txt` is camera-to-world with OpenCV axes, metres; where tracking was lost it holds what is not finite, and
/// the picture is listed as dropped. `intrinsic/intrinsic_color.txt` (or in the folder itself) is for the size of the
/// first picture, `intrinsic_depth.txt`, where there is one, for that of the first depth picture, which is then read
/// through a pinhole of its own; pixel centres are whole numbers in both. Depth is z-depth, millimetres.
///
/// # Errors
/// If a file cannot be read or breaks a rule of the format, or no picture has a pose. The message names file, line and
/// rule.
pub fn open_scannet(path: &Path) -> Result<Dataset> {
    let pictures = numbered(&path.join("color"), "", &["jpg", "jpeg", "png"])?;
    let mut poses = numbered(&path.join("pose"), "", &["txt"])?;
    let mut depths = numbered(&path.join("depth"), "", &["png", "exr"])?;
    let Some(first) = pictures.values().next() else {
        return Err(broken(&path.join("color"), FormatRule::NoFrames { hint: String::new() }));
    };
    let Some(colour) = intrinsics(path, "intrinsic_color.txt", first)? else {
        let hint = "; it holds the 4x4 matrix of the colour camera".to_owned();
        let file = path.join("intrinsic/intrinsic_color.txt");
        return Err(broken(&file, FormatRule::NoIntrinsics { hint }));
    };
    let lens = Lens { intrinsics: colour, model: LensModel::PINHOLE };
    let depth_intrinsics = match depths.values().next() {
        Some(first) => intrinsics(path, "intrinsic_depth.txt", first)?,
        None => None,
    };
    let (mut frames, mut dropped) = (Vec::new(), Vec::new());
    for (number, picture) in &pictures {
        let depth = depths.remove(number);
        let name = picture.file_stem().unwrap_or_default().to_string_lossy();
        let Some(file) = poses.remove(number) else {
            dropped.push(Dropped::new(name, "no pose: there is no file of its number in pose/"));
            continue;
        };
        let matrix = matrix_file(&file)?;
        if matrix.iter().any(|value| !value.is_finite()) {
            dropped.push(Dropped::new(name, "no pose: it is not finite, tracking was lost"));
            continue;
        }
        let pose = pose(&matrix).map_err(|rule| broken(&file, rule))?;
        let mut frame = frame(ImageSource::File(picture.clone()), lens, pose);
        let file = |path| DepthFile { intrinsics: depth_intrinsics, ..DepthFile::new(path, DEPTH_UNIT) };
        frame.depth = depth.map(file);
        frames.push(frame);
    }
    for file in poses.values().chain(depths.values()) {
        let name = file.strip_prefix(path).unwrap_or(file).display().to_string();
        dropped.push(Dropped::new(name, "no picture of its number in color/"));
    }
    if frames.is_empty() {
        let hint = format!("; {} pictures, none with a finite pose", pictures.len());
        return Err(broken(&path.join("pose"), FormatRule::NoFrames { hint }));
    }
    Ok(dataset(Format::ScanNet, path, path.join("pose"), frames, dropped))
}

/// Whether the layout lies at a path.
pub(crate) fn is_there(path: &Path) -> bool {
    ["color", "pose"].iter().all(|folder| path.join(folder).is_dir())
}

/// The pinhole of a 4×4 matrix, for the size of a picture; `None` if there is no such file.
fn intrinsics(path: &Path, name: &str, picture: &Path) -> Result<Option<Intrinsics>> {
    let files: [PathBuf; 2] = [path.join("intrinsic").join(name), path.join(name)];
    let Some(file) = files.into_iter().find(|file| file.is_file()) else { return Ok(None) };
    let m = matrix_file(&file)?;
    let size = crate::depth::size(picture)?;
    let broken = |rule| Error::Format { path: file.clone(), place: Place::Whole, rule };
    if m[1] != 0.0 || m[4] != 0.0 {
        return Err(broken(FormatRule::Skew { found: m[1] }));
    }
    Ok(Some(intrinsics_of_whole_centres([m[0], m[5], m[2], m[6]], size).map_err(broken)?))
}
