//! RealEstate10K: a text file of cameras per video clip, and the frames as pictures named by their timestamps.

mod rule;

pub use rule::Re10kRule;

use crate::camera_row::{COLUMNS, read_row};
use crate::chunk::{is_name, stages};
use crate::scene_list::{SceneEntry, SceneList};
use crate::{Dataset, Dropped, Error, Format, Frame, ImageSource, Result, Scenes};
use Re10kRule as Rule;
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// Opens every scene of `path`, see [`list_re10k`]; a scene that breaks a rule is listed as dropped.
///
/// # Errors
/// As [`list_re10k`].
pub fn open_re10k(path: &Path) -> Result<Scenes> {
    Ok(list_re10k(path)?.open_all())
}

/// Lists the scenes of `path`: a camera file `<key>.txt`, a folder of them, or a folder with `test/` or `train/` in
/// which they are. The pictures of a scene lie beside its file, `<key>/<timestamp>.png` (or `.jpg`). Camera files
/// whose folder is not there are listed as dropped: most videos are gone.
///
/// # Errors
/// If nothing of that kind lies there, or a folder cannot be listed.
pub fn list_re10k(path: &Path) -> Result<SceneList> {
    let mut list = SceneList::new(Format::Re10k);
    let mut files = Vec::new();
    if path.is_file() {
        files.push(path.to_path_buf());
    } else {
        for folder in stages(path, holds_cameras) {
            files.append(&mut camera_files(&folder)?);
        }
    }
    for path in files {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if path.with_extension("").is_dir() && is_name(&name) {
            list.entries.push(SceneEntry { name, path });
        } else {
            let reason = format!("no folder {} with its pictures", path.with_extension("").display());
            list.dropped.push(Dropped::new(name, reason));
        }
    }
    list.finish(path)
}

/// Whether camera files, each with its folder of pictures, lie at a path. None is opened.
pub(crate) fn is_there(path: &Path) -> bool {
    let is_text = path.is_file() && path.extension().is_some_and(|extension| extension == "txt");
    is_text && path.with_extension("").is_dir() || !stages(path, holds_cameras).is_empty()
}

fn holds_cameras(folder: &Path) -> bool {
    camera_files(folder).is_ok_and(|files| files.iter().any(|file| file.with_extension("").is_dir()))
}

fn camera_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let files = list_folder(folder)?;
    let is_text =
        |path: &PathBuf| path.extension().is_some_and(|extension| extension == "txt") && path.is_file();
    Ok(files.into_iter().filter(is_text).collect())
}

/// What a folder holds, sorted by name.
fn list_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |source| Error::Read { path: folder.to_path_buf(), source };
    let entries = std::fs::read_dir(folder).map_err(unreadable)?;
    let paths: std::io::Result<Vec<_>> = entries.map(|entry| Ok(entry?.path())).collect();
    let mut paths = paths.map_err(unreadable)?;
    paths.sort();
    Ok(paths)
}

/// Opens the scene of a camera file.
pub(crate) fn open_scene(file: &Path, name: &str) -> Result<Dataset> {
    let broken = |line, rule| Error::Re10k { path: file.to_path_buf(), line, rule };
    let text = crate::files::read(file).map_err(|source| Error::Read { path: file.to_path_buf(), source })?;
    let text = String::from_utf8(text).map_err(|_| broken(None, Rule::NotText))?;
    let (url, rows) = parse(&text).map_err(|(line, rule)| broken(line, rule))?;

    let folder = file.with_extension("");
    let (mut pictures, mut dropped) = pictures(&folder, &rows)?;
    let mut image = |timestamp: u64| match pictures.remove(&timestamp) {
        Some(path) => ImageSource::File(path),
        None => ImageSource::Missing(folder.join(format!("{timestamp}.png"))),
    };
    let images: Vec<ImageSource> = rows.iter().map(|row| image(row.timestamp)).collect();
    let mut sizes = Vec::with_capacity(images.len());
    for (image, row) in images.iter().zip(&rows) {
        let size = || crate::picture::size(image, &row.timestamp.to_string());
        sizes.push(if image.is_missing() { None } else { Some(size()?) });
    }
    // Frames of one video have one size; a missing one is given that of the first.
    let common = sizes.iter().flatten().copied().next().ok_or_else(|| {
        broken(None, Rule::NoPictures { frames: rows.len(), folder: folder.display().to_string() })
    })?;
    let mut frames = Vec::with_capacity(rows.len());
    for ((image, row), size) in images.into_iter().zip(&rows).zip(sizes) {
        let camera = read_row(&row.camera, size.unwrap_or(common))
            .map_err(|rule| broken(Some(row.line), Rule::Camera(rule)))?;
        if image.is_missing() {
            let reason = format!("picture missing: {image}");
            dropped.push(Dropped::new(row.timestamp.to_string(), reason));
        }
        let mut frame = Frame::of_row(row.timestamp.to_string(), image, camera);
        frame.time = Some(row.timestamp as f64 * 1e-6);
        frames.push(frame);
    }
    let mut dataset = Dataset::new(Format::Re10k, name.to_owned(), file.to_path_buf(), folder, frames);
    dataset.url = url;
    dataset.dropped = dropped;
    Ok(dataset)
}

/// The pictures of a folder by timestamp, and those that have no camera.
fn pictures(folder: &Path, rows: &[Row]) -> Result<(BTreeMap<u64, PathBuf>, Vec<Dropped>)> {
    let known: HashSet<u64> = rows.iter().map(|row| row.timestamp).collect();
    let (mut pictures, mut dropped) = (BTreeMap::new(), Vec::new());
    for path in list_folder(folder)? {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        if !["png", "jpg", "jpeg"].iter().any(|known| extension == *known) {
            continue;
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let timestamp = stem.parse().ok().filter(|timestamp| known.contains(timestamp));
        let reason = match timestamp {
            None => "no camera for this picture",
            Some(timestamp) if pictures.contains_key(&timestamp) => {
                "a picture of this timestamp comes before"
            }
            Some(timestamp) => {
                pictures.insert(timestamp, path);
                continue;
            }
        };
        dropped.push(Dropped::new(path.display().to_string(), reason));
    }
    Ok((pictures, dropped))
}

/// A line of a camera file.
struct Row {
    /// Number of the line, from 1.
    line: usize,
    /// Microseconds.
    timestamp: u64,
    camera: [f64; COLUMNS],
}

type Broken = (Option<usize>, Rule);

/// The URL, if the first line has one, and the cameras.
fn parse(text: &str) -> std::result::Result<(Option<String>, Vec<Row>), Broken> {
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let url = lines.next().map(|(_, url)| url.to_owned()).filter(|url| !url.is_empty());
    let (mut rows, mut timestamps) = (Vec::new(), HashSet::new());
    for (line, text) in lines.filter(|(_, text)| !text.is_empty()) {
        let row = parse_row(text).map_err(|rule| (Some(line), rule))?;
        if !timestamps.insert(row.0) {
            return Err((Some(line), Rule::DuplicateTimestamp { timestamp: row.0 }));
        }
        rows.push(Row { line, timestamp: row.0, camera: row.1 });
    }
    if rows.is_empty() { Err((None, Rule::NoCameras)) } else { Ok((url, rows)) }
}

fn parse_row(text: &str) -> std::result::Result<(u64, [f64; COLUMNS]), Rule> {
    let found = text.split_whitespace().count();
    if found != COLUMNS + 1 {
        return Err(Rule::Columns { found });
    }
    let clipped = |text: &str| text.chars().take(32).collect();
    let mut camera = [0.0; COLUMNS];
    let mut timestamp = 0;
    for (column, text) in text.split_whitespace().enumerate() {
        if column == 0 {
            timestamp = text.parse().map_err(|_| Rule::Timestamp { found: clipped(text) })?;
        } else {
            camera[column - 1] = text.parse().map_err(|_| Rule::Number { column, found: clipped(text) })?;
        }
    }
    Ok((timestamp, camera))
}
