//! Names of data sets and frames.

use crate::Frame;
use std::collections::HashMap;
use std::path::Path;

/// Names frames by the stem of their file, or by the whole path in `paths` if a stem occurs twice.
pub(crate) fn name_frames<'a>(frames: &mut [Frame], paths: impl Iterator<Item = &'a str>) {
    let stem =
        |frame: &Frame| frame.image.path().file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut count: HashMap<String, usize> = HashMap::new();
    for frame in &*frames {
        *count.entry(stem(frame)).or_default() += 1;
    }
    for (frame, path) in frames.iter_mut().zip(paths) {
        let stem = stem(frame);
        frame.name = if count[&stem] == 1 { stem } else { path.replace(['/', '\\'], "_") };
    }
}

/// Name of a folder, whatever way it was written.
pub(crate) fn folder_name(root: &Path) -> String {
    let full = std::fs::canonicalize(root).unwrap_or_else(|_| root.to_path_buf());
    full.file_name().unwrap_or(full.as_os_str()).to_string_lossy().into_owned()
}
