//! TUM RGB-D: `rgb.txt`, `depth.txt` and `groundtruth.txt`, each with times of its own.

use crate::files::{Lines, broken};
use crate::trajectory::{Pose, dataset, frame, intrinsics_of_whole_centres};
use crate::{
    Dataset, DepthFile, Distortion, Dropped, Error, Format, FormatRule, ImageSource, Lens, LensModel, Result,
};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};

/// Metres per count of depth.
const DEPTH_UNIT: f64 = 1.0 / 5000.0;
/// Farthest apart that times may lie and still mean one moment, seconds: that of the benchmark's own tool.
const MAX_DIFFERENCE: f64 = 0.02;
/// Files that may state the camera of a sequence.
const CAMERA_FILES: [&str; 2] = ["camera.txt", "calibration.txt"];

/// Calibrations of the colour cameras as the benchmark publishes them: words of the sequence's name; fx fy cx cy with
/// pixel centres at whole numbers; k1 k2 p1 p2 k3. Pictures are 640×480.
const KNOWN: [([&str; 2], [f64; 4], [f64; 5]); 3] = [
    (["freiburg1", "fr1"], [517.3, 516.5, 318.6, 255.3], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    (["freiburg2", "fr2"], [520.9, 521.0, 325.1, 249.7], [0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
    (["freiburg3", "fr3"], [535.4, 539.2, 320.1, 247.6], [0.0; 5]),
];

/// Opens a sequence of the TUM RGB-D benchmark: [`open_tum_within`] 0.02 seconds.
///
/// # Errors
/// As [`open_tum_within`].
pub fn open_tum(path: &Path) -> Result<Dataset> {
    open_tum_within(path, MAX_DIFFERENCE)
}

/// Opens a sequence in the layout of the TUM RGB-D benchmark.
///
/// Frames are the pictures of `rgb.txt` in its order. Each takes the pose of `groundtruth.txt` (camera-to-world, OpenCV
/// axes, quaternion with w last) and the picture of `depth.txt` that are nearest in time, if they are at most
/// `max_difference` seconds away; a picture without such a pose is listed as dropped. Depth is z-depth, 1/5000 m per
/// count, and covers what the picture covers. Poses are not interpolated.
///
/// The camera is that of a file `camera.txt` or `calibration.txt` in the folder (`fx fy cx cy [k1 k2 p1 p2 [k3]]`,
/// pixel centres at whole numbers), or, for sequences with `freiburg1`, `freiburg2` or `freiburg3` in their names, the
/// benchmark's calibration with its distortion.
///
/// # Errors
/// If there is no camera, a file cannot be read or breaks a rule of the format, or no picture has a pose. The message
/// names file, line and rule.
pub fn open_tum_within(path: &Path, max_difference: f64) -> Result<Dataset> {
    let list = path.join("rgb.txt");
    let pictures = timed_files(&list)?;
    if pictures.is_empty() {
        return Err(broken(&list, FormatRule::NoFrames { hint: "; it lists no pictures".to_owned() }));
    }
    let mut depths = match timed_files(&path.join("depth.txt")) {
        Err(Error::Read { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Vec::new(),
        other => other?,
    };
    depths.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut poses = timed_poses(&path.join("groundtruth.txt"))?;
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));

    let lens = lens(path, pictures.first().map(|(_, file)| file.as_path()))?;
    let (mut frames, mut dropped) = (Vec::new(), Vec::new());
    for (time, file) in &pictures {
        let name = || file.file_stem().unwrap_or_default().to_string_lossy();
        let pose = match nearest(&poses, *time) {
            Some((away, pose)) if away <= max_difference => *pose,
            found => {
                let reason = match found {
                    Some((away, _)) => format!("no pose: the nearest in time is {away:.3} s away"),
                    None => "no pose: groundtruth.txt has none".to_owned(),
                };
                dropped.push(Dropped::new(name(), reason));
                continue;
            }
        };
        let is_there = file.is_file();
        let image =
            if is_there { ImageSource::File(file.clone()) } else { ImageSource::Missing(file.clone()) };
        let mut frame = frame(image, lens, pose);
        frame.time = Some(*time);
        let depth = nearest(&depths, *time).filter(|(away, _)| *away <= max_difference);
        frame.depth = depth.map(|(_, path)| DepthFile::new(path.clone(), DEPTH_UNIT));
        frames.push(frame);
    }
    if frames.is_empty() {
        let hint = format!(
            "; {} pictures, {} poses, at most {max_difference} s apart; do the clocks agree?",
            pictures.len(),
            poses.len()
        );
        return Err(broken(&list, FormatRule::NoFrames { hint }));
    }
    Ok(dataset(Format::Tum, path, list, frames, dropped))
}

/// Whether the layout lies at a path.
pub(crate) fn is_there(path: &Path) -> bool {
    path.join("rgb.txt").is_file() && path.join("groundtruth.txt").is_file()
}

/// `time path` per line, paths beside the list.
fn timed_files(list: &Path) -> Result<Vec<(f64, PathBuf)>> {
    let folder = list.parent().unwrap_or(Path::new("."));
    let mut lines = Lines::open(list)?;
    let mut files = Vec::new();
    while let Some(line) = lines.next_entry()? {
        let ([time], name) = line.split("TIME PATH")?;
        if name.is_empty() {
            return Err(line.broken(FormatRule::Words { expected: "TIME PATH", found: 1 }));
        }
        files.push((line.number("TIME", time)?, folder.join(name)));
    }
    Ok(files)
}

fn timed_poses(file: &Path) -> Result<Vec<(f64, Pose)>> {
    let mut lines = Lines::open(file)?;
    let mut poses = Vec::new();
    while let Some(line) = lines.next_entry()? {
        let ([time, tx, ty, tz, x, y, z, w], _) = line.split("TIME TX TY TZ QX QY QZ QW")?;
        let time = line.number("TIME", time)?;
        let position = DVec3::from(line.numbers("translation", [tx, ty, tz])?);
        let quaternion = line.numbers("quaternion", [w, x, y, z])?;
        let rotation = crate::dataset::unit_quaternion(quaternion);
        let rotation = rotation.map_err(|rule| line.broken(FormatRule::Pose(rule)))?;
        poses.push((time, (DMat3::from_quat(rotation), position)));
    }
    Ok(poses)
}

/// The entry nearest in time, and how far it is away; of two equally near the earlier.
fn nearest<T>(sorted: &[(f64, T)], time: f64) -> Option<(f64, &T)> {
    let after = sorted.partition_point(|(other, _)| *other < time);
    let candidates = sorted[after.saturating_sub(1)..].iter().take(2);
    let distances = candidates.map(|(other, value)| ((other - time).abs(), value));
    distances.min_by(|a, b| a.0.total_cmp(&b.0))
}

fn lens(path: &Path, first: Option<&Path>) -> Result<Lens> {
    let stated = CAMERA_FILES.into_iter().map(|name| path.join(name)).find(|file| file.is_file());
    if let Some(file) = stated {
        return stated_lens(&file, first);
    }
    let name = crate::files::folder_name(path).to_lowercase();
    let known = KNOWN.iter().find(|(words, _, _)| words.iter().any(|word| name.contains(word)));
    let Some((_, numbers, [k1, k2, p1, p2, k3])) = known else {
        let hint = "; write fx fy cx cy [k1 k2 p1 p2 [k3]] into it (the folder's name tells none of the \
                    benchmark's cameras freiburg1, freiburg2, freiburg3)";
        let file = path.join(CAMERA_FILES[0]);
        return Err(broken(&file, FormatRule::NoIntrinsics { hint: hint.to_owned() }));
    };
    let intrinsics = intrinsics_of_whole_centres(*numbers, (640, 480)).map_err(|rule| broken(path, rule))?;
    Ok(Lens { intrinsics, model: Distortion { k1: *k1, k2: *k2, k3: *k3, p1: *p1, p2: *p2 }.into() })
}

/// The camera of a file; it is for the size of the first picture.
fn stated_lens(file: &Path, first: Option<&Path>) -> Result<Lens> {
    let mut lines = Lines::open(file)?;
    let expected = "fx fy cx cy [k1 k2 p1 p2 [k3]]";
    let Some(line) = lines.next_entry()? else {
        return Err(broken(file, FormatRule::Words { expected, found: 0 }));
    };
    let numbers = line.words().map(|word| line.number("a camera parameter", word));
    let numbers = numbers.collect::<Result<Vec<_>>>()?;
    let (pinhole, model) = match *numbers.as_slice() {
        [fx, fy, cx, cy] => ([fx, fy, cx, cy], LensModel::PINHOLE),
        [fx, fy, cx, cy, k1, k2, p1, p2] => ([fx, fy, cx, cy], Distortion { k1, k2, k3: 0.0, p1, p2 }.into()),
        [fx, fy, cx, cy, k1, k2, p1, p2, k3] => ([fx, fy, cx, cy], Distortion { k1, k2, k3, p1, p2 }.into()),
        _ => return Err(line.broken(FormatRule::Words { expected, found: numbers.len() })),
    };
    let first = first.map(|first| ImageSource::File(first.to_path_buf()));
    let no_pictures = || broken(file, FormatRule::NoFrames { hint: String::new() });
    let size = crate::picture::size(&first.ok_or_else(no_pictures)?, "0")?;
    let intrinsics = intrinsics_of_whole_centres(pinhole, size).map_err(|rule| line.broken(rule))?;
    Ok(Lens { intrinsics, model })
}
