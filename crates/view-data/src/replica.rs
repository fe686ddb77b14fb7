//! Replica as rendered for iMAP and NICE-SLAM: `traj.txt`, `results/frame000000.jpg`, `results/depth000000.png`.

use crate::files::{Lines, broken};
use crate::nerfstudio::keys::{self, Keys};
use crate::trajectory::{dataset, frame, intrinsics_of_whole_centres, matrix_line, numbered, pose};
use crate::{
    Dataset, DepthFile, Dropped, Error, Format, FormatRule, ImageSource, Lens, LensModel, Result,
    TransformsRule as Rule,
};
use std::path::Path;

/// Count of a pixel without depth beside 0: the farthest value is what a ray that hits nothing gets.
const FARTHEST: f64 = 65535.0;
const CAMERA: &str = "cam_params.json";

/// Opens a scene of Replica in NICE-SLAM's layout: `path` holds `traj.txt` and `results/`; `cam_params.json` lies there
/// or in the folder above, its keys `w h fx fy cx cy scale` at the top or under `camera`.
///
/// Line n of `traj.txt` (camera-to-world, OpenCV axes, metres) is the pose of picture n, by the number in its name. A
/// line without picture is a frame whose picture is missing, a picture without line is listed as dropped. Pixel
/// centres are whole numbers in this layout: 0.5 is added to `cx` and `cy`. Depth is z-depth, count / `scale` metres;
/// 0 and 65535 are no measurement.
///
/// # Errors
/// If a file cannot be read or breaks a rule of the format; the message names file, line and rule.
pub fn open_replica(path: &Path) -> Result<Dataset> {
    let (lens, unit) = camera(path)?;
    let results = path.join("results");
    let mut pictures = numbered(&results, "frame", &["jpg", "jpeg", "png"])?;
    let mut depths = numbered(&results, "depth", &["png", "exr"])?;
    let file = path.join("traj.txt");
    let mut lines = Lines::open(&file)?;
    let mut frames = Vec::new();
    while let Some(line) = lines.next_entry()? {
        let number = frames.len() as u64;
        let pose = pose(&matrix_line(&line)?).map_err(|rule| line.broken(rule))?;
        let image = pictures.remove(&number).map(ImageSource::File);
        let image =
            image.unwrap_or_else(|| ImageSource::Missing(results.join(format!("frame{number:06}.jpg"))));
        let mut frame = frame(image, lens, pose);
        let depth = |path| DepthFile { max_count: FARTHEST - 1.0, ..DepthFile::new(path, unit) };
        frame.depth = depths.remove(&number).map(depth);
        frames.push(frame);
    }
    if frames.is_empty() {
        return Err(broken(&file, FormatRule::NoFrames { hint: String::new() }));
    }
    let left_over = pictures.values().chain(depths.values());
    let dropped = left_over.map(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        Dropped::new(name, format!("no pose: traj.txt has {} lines", frames.len()))
    });
    let dropped = dropped.collect();
    Ok(dataset(Format::Replica, path, file, frames, dropped))
}

/// Whether the layout lies at a path.
pub(crate) fn is_there(path: &Path) -> bool {
    path.join("traj.txt").is_file() && path.join("results").is_dir()
}

/// The lens, and metres per count of depth.
fn camera(path: &Path) -> Result<(Lens, f64)> {
    let full = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let beside = path.join(CAMERA);
    let above = full.parent().map(|parent| parent.join(CAMERA));
    let file = std::iter::once(beside.clone()).chain(above).find(|file| file.is_file());
    let Some(file) = file else {
        let hint = "; or put it in the folder above; it holds {\"camera\": {\"w\": .., \"h\": .., \"fx\": .., \
                    \"fy\": .., \"cx\": .., \"cy\": .., \"scale\": ..}}";
        return Err(broken(&beside, FormatRule::NoIntrinsics { hint: hint.to_owned() }));
    };
    let text = crate::files::read(&file).map_err(crate::files::unreadable(&file))?;
    let json = keys::parse(&text).map_err(|source| Error::Json { path: file.clone(), source })?;
    let top = Keys::new(&file, None, &json)?;
    let keys = top.object("camera")?.unwrap_or(top);
    let number = |key: &'static str| keys.number(key)?.ok_or_else(|| keys.broken(Rule::MissingKey { key }));
    let size = (keys.side("w", number("w")?)?, keys.side("h", number("h")?)?);
    let numbers = [number("fx")?, number("fy")?, number("cx")?, number("cy")?];
    let scale = number("scale")?;
    keys.require(scale > 0.0, "scale", scale, "counts of depth per metre, a number above 0")?;
    let intrinsics = intrinsics_of_whole_centres(numbers, size).map_err(|rule| broken(&file, rule))?;
    Ok((Lens { intrinsics, model: LensModel::PINHOLE }, scale.recip()))
}
