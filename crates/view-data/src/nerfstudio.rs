//! nerfstudio's `transforms.json`: intrinsics per frame or for the file, camera-to-world poses with OpenGL axes
//! (x right, y up, z backward).

pub(crate) mod keys;
mod pictures;

use crate::dataset::nearest_rotation;
use crate::files::{folder_name, name_frames};
use crate::points::PointSource;
use crate::{
    Dataset, DepthFile, DepthPercentiles, Distortion, Dropped, Error, Format, Frame, ImageSource, Lens,
    LensModel, Result, TransformsRule as Rule,
};
use glam::{DMat3, DVec3};
use gs_scene::Intrinsics;
use keys::Keys;
use pictures::Pictures;
use serde_json::Value;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Camera models that are read: pinholes with distortion by k1 k2 k3 p1 p2, or all of k1 to k6 and p1 p2, and
/// equidistant projections with k1 k2 k3 k4.
pub(crate) const MODELS: [&str; 9] = [
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
    "FULL_OPENCV",
    "OPENCV_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
];
/// Longest side of a picture, pixels.
pub(crate) const MAX_SIDE: usize = 1 << 20;
/// Keys of the camera that stand on a frame or at the top of the file.
const CAMERA_KEYS: [&str; 18] = [
    "camera_model",
    "w",
    "h",
    "fl_x",
    "fl_y",
    "cx",
    "cy",
    "camera_angle_x",
    "camera_angle_y",
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "is_fisheye",
];
/// Metres per count of a depth file, unless `depth_unit_scale_factor` says otherwise: millimetres.
const DEFAULT_DEPTH_UNIT: f64 = 0.001;

/// Opens a data set in nerfstudio's layout: `path` is a `transforms.json` or the folder that holds one, or `transforms_train.json`.
///
/// Reads the JSON, and of the pictures no more than their headers, those only where the file gives no `w` and `h`.
/// Frames keep the file's order, and poses the file's world (see [`Dataset::applied_transform`]).
///
/// # Errors
/// If the file cannot be read or breaks a rule of the format; the message names file, frame and rule.
pub fn open_nerfstudio(path: &Path) -> Result<Dataset> {
    let file = if path.is_dir() { file_in(path) } else { path.to_path_buf() };
    let mut dataset = open_file(file, None)?;
    // Blender's sets come in parts, of which the first is for what views are reconstructed from.
    if dataset.file.file_name().is_some_and(|name| name == PARTS[0]) {
        for part in PARTS[1..].iter().filter(|part| dataset.root.join(part).is_file()) {
            dataset.dropped.push(Dropped::new(*part, "not read: give this file to use its frames"));
        }
    }
    Ok(dataset)
}

/// Files of a set that comes in parts.
const PARTS: [&str; 3] = ["transforms_train.json", "transforms_val.json", "transforms_test.json"];

/// The file of a folder.
pub(crate) fn file_in(folder: &Path) -> PathBuf {
    let names = ["transforms.json", PARTS[0]].map(|name| folder.join(name));
    let [whole, part] = names;
    if !whole.is_file() && part.is_file() { part } else { whole }
}

/// As [`open_nerfstudio`], but every picture is looked for in one folder, by its name alone.
pub(crate) fn open_with_pictures_in(file: &Path, folder: &Path) -> Result<Dataset> {
    open_file(file.to_path_buf(), Some(folder))
}

fn open_file(file: PathBuf, picture_folder: Option<&Path>) -> Result<Dataset> {
    let text = crate::files::read(&file).map_err(|source| Error::Read { path: file.clone(), source })?;
    let json = keys::parse(&text).map_err(|source| Error::Json { path: file.clone(), source })?;
    let root = match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let shared = Keys::new(&file, None, &json)?;
    let list = shared.list("frames")?.ok_or_else(|| shared.broken(Rule::MissingKey { key: "frames" }))?;
    if list.is_empty() {
        return Err(shared.broken(Rule::NoFrames));
    }

    let frames = list.iter().enumerate().map(|(position, value)| {
        let path = value.get("file_path").and_then(Value::as_str).unwrap_or("no file_path");
        Keys::new(&file, Some(format!("{position} ({path})")), value)
    });
    let frames = frames.collect::<Result<Vec<_>>>()?;
    let on_some_frame = |key: &&str| !shared.has(key) && frames.iter().any(|frame| frame.has(key));
    let per_frame: Vec<_> = CAMERA_KEYS.into_iter().filter(on_some_frame).collect();

    let unit = shared.number("depth_unit_scale_factor")?;
    if let Some(unit) = unit {
        shared.require(unit > 0.0, "depth_unit_scale_factor", unit, "a number above 0")?;
    }

    let mut pictures = Pictures::new(&root, picture_folder);
    let mut position_of = HashMap::new();
    let mut read = Vec::with_capacity(frames.len());
    for (position, keys) in frames.iter().enumerate() {
        if let Some(key) = per_frame.iter().find(|key| !keys.has(key)) {
            return Err(keys.broken(Rule::PartialKey { key }));
        }
        let frame = read_frame(keys, &shared, &mut pictures, unit)?;
        if let Some(first) = position_of.insert(frame.image.path().to_path_buf(), position) {
            return Err(keys.broken(Rule::DuplicateFrame { first }));
        }
        read.push(frame);
    }
    let file_path = |keys: &Keys| keys.text("file_path").ok().flatten().unwrap_or_default().to_owned();
    let paths: Vec<String> = frames.iter().map(file_path).collect();
    name_frames(&mut read, paths.iter().map(String::as_str));

    let dropped =
        read.iter().filter(|frame| frame.image.is_missing()).map(Dropped::missing_picture).collect();
    Ok(Dataset {
        name: folder_name(&root),
        depth_percentiles: depth_percentiles(&shared)?,
        applied_transform: shared.matrix("applied_transform")?,
        offset: None,
        applied_scale: shared.number("applied_scale")?,
        format: Format::Nerfstudio,
        url: None,
        dropped,
        points: shared.text("ply_file_path")?.map(|path| PointSource::Ply(pictures.beside(path))),
        frames: read,
        file,
        root,
    })
}

fn read_frame(keys: &Keys, shared: &Keys, pictures: &mut Pictures, unit: Option<f64>) -> Result<Frame> {
    let file_path = keys.text("file_path")?.filter(|path| !path.is_empty());
    let file_path = file_path.ok_or_else(|| keys.broken(Rule::MissingKey { key: "file_path" }))?;
    let image =
        pictures.find(file_path).map_err(|folders| keys.broken(Rule::AmbiguousPicture { folders }))?;
    let lens = read_lens(keys, shared, &image)?;
    let matrix = keys.matrix("transform_matrix")?;
    let matrix = matrix.ok_or_else(|| keys.broken(Rule::MissingKey { key: "transform_matrix" }))?;
    let opengl = nearest_rotation(matrix.matrix3).map_err(|rule| keys.broken(Rule::Pose(rule)))?;
    let frame = Frame {
        name: String::new(),
        time: None,
        depth: keys.text("depth_file_path")?.map(|path| depth_file(pictures.beside(path), unit)),
        mask_path: keys.text("mask_path")?.map(|path| pictures.beside(path)),
        image,
        lens,
        axes: opengl * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        position: matrix.translation,
    };
    frame.camera().map_err(|source| keys.broken(Rule::Camera(source)))?;
    Ok(frame)
}

/// Without a stated unit, whole numbers are millimetres as nerfstudio takes them, and EXR files hold scene units.
fn depth_file(path: PathBuf, unit: Option<f64>) -> DepthFile {
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    let unit = unit.unwrap_or(if is_exr { 1.0 } else { DEFAULT_DEPTH_UNIT });
    DepthFile::new(path, unit)
}

fn read_lens(keys: &Keys, shared: &Keys, image: &ImageSource) -> Result<Lens> {
    // A value of the frame overrides the file's; where it stands decides whom the error names.
    let source = |key| if keys.has(key) { keys } else { shared };
    let number = |key| source(key).number(key);
    let coefficient = |key| -> Result<f64> { Ok(number(key)?.unwrap_or(0.0)) };

    let model = source("camera_model").text("camera_model")?;
    if let Some(model) = model.filter(|model| !MODELS.contains(model)) {
        return Err(keys.broken(Rule::Model { found: model.to_owned() }));
    }
    let is_fisheye = model.is_some_and(|model| model.ends_with("FISHEYE"))
        || source("is_fisheye").flag("is_fisheye")? == Some(true);
    let is_rational = model == Some("FULL_OPENCV");
    // What the model has no place for must not be there.
    let unused: &[&'static str] = match (is_fisheye, is_rational) {
        (true, _) => &["k5", "k6", "p1", "p2"],
        (_, true) => &[],
        _ => &["k4", "k5", "k6"],
    };
    for key in unused.iter().copied() {
        let found = coefficient(key)?;
        if found != 0.0 {
            return Err(keys.broken(Rule::Coefficient { key, found }));
        }
    }
    let [k1, k2, k3] = [coefficient("k1")?, coefficient("k2")?, coefficient("k3")?];
    let [k4, k5, k6] = [coefficient("k4")?, coefficient("k5")?, coefficient("k6")?];
    let [p1, p2] = [coefficient("p1")?, coefficient("p2")?];
    let lens_model = match (is_fisheye, is_rational) {
        (true, _) => LensModel::Fisheye { k: [k1, k2, k3, k4] },
        (_, true) => LensModel::Rational { k: [k1, k2, k3, k4, k5, k6], p: [p1, p2] },
        _ => Distortion { k1, k2, k3, p1, p2 }.into(),
    };
    if let Some(model) = model.filter(|model| model.ends_with("PINHOLE") && !lens_model.is_pinhole()) {
        return Err(keys.broken(Rule::DistortedPinhole { model: model.to_owned() }));
    }

    let (width, height) = match (number("w")?, number("h")?) {
        (Some(w), Some(h)) => (source("w").side("w", w)?, source("h").side("h", h)?),
        _ => crate::picture::size(image, keys.label())?,
    };
    let from_angle = |key, side: usize| -> Result<Option<f64>> {
        let Some(angle) = number(key)? else { return Ok(None) };
        let inside = angle > 0.0 && angle < std::f64::consts::PI;
        source(key).require(inside, key, angle, "an angle between 0 and π, in radians")?;
        Ok(Some(side as f64 * 0.5 / (angle * 0.5).tan()))
    };
    let given =
        |key, angle_key, side| -> Result<Option<f64>> { Ok(number(key)?.or(from_angle(angle_key, side)?)) };
    let fx: Option<f64> = given("fl_x", "camera_angle_x", width)?;
    let fx = fx.ok_or_else(|| keys.broken(Rule::NoFocal))?;
    let fy: Option<f64> = given("fl_y", "camera_angle_y", height)?;
    let (cx, cy) = (number("cx")?, number("cy")?);
    let intrinsics = Intrinsics {
        fx,
        fy: fy.unwrap_or(fx),
        cx: cx.unwrap_or(width as f64 * 0.5),
        cy: cy.unwrap_or(height as f64 * 0.5),
        width,
        height,
    };
    Ok(Lens { intrinsics, model: lens_model })
}

fn depth_percentiles(shared: &Keys) -> Result<Option<DepthPercentiles>> {
    let Some(percentiles) = shared.object("scene_depth_percentiles")? else { return Ok(None) };
    let number = |key| percentiles.number(key)?.ok_or_else(|| shared.broken(Rule::MissingKey { key }));
    let found = [number("0.5")?, number("2")?, number("50")?, number("98")?, number("99.5")?];
    if !(found[0] > 0.0 && found.is_sorted()) {
        return Err(shared.broken(Rule::Percentiles { found }));
    }
    let [p0_5, p2, p50, p98, p99_5] = found;
    Ok(Some(DepthPercentiles { p0_5, p2, p50, p98, p99_5 }))
}
