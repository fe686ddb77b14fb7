//! Shared parts of layouts with one camera and one pose per frame: matrices in text, numbered files, measured depth.

use crate::dataset::nearest_rotation;
use crate::files::{Line, Lines, broken, unreadable};
use crate::{Dataset, Dropped, Error, FormatRule, Frame, Lens, Result};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Intrinsics};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Camera-to-world: axes as columns (OpenCV) and position.
pub(crate) type Pose = (DMat3, DVec3);

/// The pose of a 4×4 camera-to-world matrix, row by row.
pub(crate) fn pose(matrix: &[f64; 16]) -> std::result::Result<Pose, FormatRule> {
    if let Some(&found) = matrix.iter().find(|value| !value.is_finite()) {
        return Err(FormatRule::NotFinite { what: "a number of the matrix", found });
    }
    let last = [matrix[12], matrix[13], matrix[14], matrix[15]];
    if last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(found, expected)| (found - expected).abs() > 1e-6) {
        return Err(FormatRule::LastRow { found: last });
    }
    let column = |c: usize| DVec3::new(matrix[c], matrix[4 + c], matrix[8 + c]);
    let axes = nearest_rotation(DMat3::from_cols(column(0), column(1), column(2)))?;
    Ok((axes, column(3)))
}

/// The 16 numbers of a line.
pub(crate) fn matrix_line(line: &Line<'_>) -> Result<[f64; 16]> {
    let words: Vec<&str> = line.words().collect();
    let expected = "16 numbers: a 4x4 camera-to-world matrix, row by row";
    let words: [&str; 16] = words
        .try_into()
        .map_err(|words: Vec<_>| line.broken(FormatRule::Words { expected, found: words.len() }))?;
    let mut matrix = [0.0; 16];
    for (value, word) in matrix.iter_mut().zip(words) {
        // Not `number`: what is not finite marks a lost frame in some layouts.
        *value = line.parsed("a number of the matrix", word, "a number")?;
    }
    Ok(matrix)
}

/// A file of one 4×4 matrix, a row per line.
pub(crate) fn matrix_file(path: &Path) -> Result<[f64; 16]> {
    let mut lines = Lines::open(path)?;
    let (mut matrix, mut rows) = ([0.0; 16], 0);
    while let Some(line) = lines.next_entry()? {
        let words: Vec<&str> = line.words().collect();
        if words.len() != 4 || rows == 4 {
            let found = words.len();
            return Err(line.broken(FormatRule::Words { expected: "4 lines of 4 numbers", found }));
        }
        for (i, word) in words.into_iter().enumerate() {
            matrix[4 * rows + i] = line.parsed("a number of the matrix", word, "a number")?;
        }
        rows += 1;
    }
    if rows < 4 {
        return Err(broken(path, FormatRule::Words { expected: "4 lines of 4 numbers", found: rows * 4 }));
    }
    Ok(matrix)
}

/// Intrinsics whose pixel centres are whole numbers, in our convention (centres at +0.5), checked; the principal point
/// must lie inside the picture, which it does not if the numbers are for another size.
pub(crate) fn intrinsics_of_whole_centres(
    [fx, fy, cx, cy]: [f64; 4],
    (width, height): (usize, usize),
) -> std::result::Result<Intrinsics, FormatRule> {
    let intrinsics = Intrinsics { fx, fy, cx: cx + 0.5, cy: cy + 0.5, width, height };
    Camera::new(intrinsics, DMat3::IDENTITY, DVec3::ZERO).map_err(FormatRule::Camera)?;
    let inside = |centre: f64, side: usize| centre > 0.0 && centre < side as f64;
    if !(inside(cx + 0.5, width) && inside(cy + 0.5, height)) {
        return Err(FormatRule::PrincipalPoint { found: [cx, cy], width, height });
    }
    Ok(intrinsics)
}

/// Files of a folder named by `prefix`, a number, and one of `extensions`, by their numbers. Of two with one number the
/// later name counts. A folder that is not there has none.
pub(crate) fn numbered(folder: &Path, prefix: &str, extensions: &[&str]) -> Result<BTreeMap<u64, PathBuf>> {
    let mut files = BTreeMap::new();
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(files),
        Err(source) => return Err(Error::Read { path: folder.to_path_buf(), source }),
    };
    let mut paths: Vec<PathBuf> = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(unreadable(folder))?.path());
    }
    paths.sort();
    for path in paths {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.strip_prefix(prefix).filter(|digits| digits.bytes().all(|b| b.is_ascii_digit()));
        if extensions.contains(&&*extension)
            && let Some(number) = number.and_then(|digits| digits.parse().ok())
        {
            files.insert(number, path);
        }
    }
    Ok(files)
}

/// A frame without depth and mask.
pub(crate) fn frame(image: crate::ImageSource, lens: Lens, (axes, position): Pose) -> Frame {
    let name = image.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Frame { name, time: None, image, depth: None, mask_path: None, lens, axes, position }
}

/// What a data set of these frames would say of depth: nothing if all frames have some or none, else how many lack it.
pub(crate) fn missing_depth(frames: &[Frame]) -> Option<Dropped> {
    let lacking: Vec<_> = frames.iter().filter(|frame| frame.depth.is_none()).collect();
    let first = lacking.first().filter(|_| lacking.len() < frames.len())?;
    let reason =
        format!("no depth for {} of {} frames, the first is {}", lacking.len(), frames.len(), first.name);
    Some(Dropped::new("depth", reason))
}

/// A data set without what these layouts do not have.
pub(crate) fn dataset(
    format: crate::Format,
    root: &Path,
    file: PathBuf,
    frames: Vec<Frame>,
    mut dropped: Vec<Dropped>,
) -> Dataset {
    dropped.extend(frames.iter().filter(|frame| frame.image.is_missing()).map(Dropped::missing_picture));
    dropped.extend(missing_depth(&frames));
    Dataset {
        name: crate::files::folder_name(root),
        file,
        root: root.to_path_buf(),
        format,
        frames,
        dropped,
        depth_percentiles: None,
        url: None,
        applied_transform: None,
        offset: None,
        applied_scale: None,
        points: None,
    }
}
