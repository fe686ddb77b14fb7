//! The journal of a sweep, as JSON lines: the recipe first, then a line per window, point and seed.

use super::SweepError;
use super::measure::Measured;
use super::shard::Shard;
use super::sweep::Label;
use gs_scene::{lock_file, write_atomically};
use scene_windows::Dropped;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The first line: what is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// How to make it again.
    pub recipe: Value,
    /// Which windows are in this file.
    pub shard: Shard,
    /// All windows of the sweep, in order.
    pub windows: Vec<String>,
    /// All points, in order.
    pub points: Vec<Label>,
    /// All seeds.
    pub seeds: Vec<u64>,
    /// The network that LPIPS is measured with; none without weights.
    pub lpips_network: Option<String>,
    /// What could not even be planned.
    pub dropped: Vec<Dropped>,
}

/// Parts of a recipe that may differ between runs whose figures belong together.
const OF_THE_RUN: [&str; 2] = ["recipe.command", "recipe.machine.memory_bytes"];

impl Header {
    /// Where two sweeps differ in what makes their figures comparable: the place, and what stands there here and in the other.
    fn difference(&self, other: &Self) -> Option<(String, String, String)> {
        let identity = |header: &Self| serde_json::to_value(Self { shard: Shard::WHOLE, ..header.clone() });
        match (identity(self), identity(other)) {
            (Ok(a), Ok(b)) => difference("", &a, &b),
            _ => None,
        }
    }

    fn check(&self, path: &Path, other: &Self) -> Result<(), SweepError> {
        match self.difference(other) {
            Some((key, expected, found)) => {
                Err(SweepError::OtherRecipe { path: path.to_path_buf(), key, expected, found })
            }
            None => Ok(()),
        }
    }
}

/// The first place where two values differ.
fn difference(place: &str, a: &Value, b: &Value) -> Option<(String, String, String)> {
    if a == b || OF_THE_RUN.contains(&place) {
        return None;
    }
    let below = |key: &str| if place.is_empty() { key.to_owned() } else { format!("{place}.{key}") };
    match (a, b) {
        (Value::Object(x), Value::Object(y)) => {
            let keys = x.keys().chain(y.keys().filter(|key| !x.contains_key(*key)));
            let field =
                |map: &serde_json::Map<String, Value>, key: &str| map.get(key).cloned().unwrap_or_default();
            keys.into_iter().find_map(|key| difference(&below(key), &field(x, key), &field(y, key)))
        }
        (Value::Array(x), Value::Array(y)) if x.len() == y.len() => {
            x.iter().zip(y).enumerate().find_map(|(i, (x, y))| difference(&below(&i.to_string()), x, y))
        }
        _ => Some((place.to_owned(), shortened(a), shortened(b))),
    }
}

/// JSON, cut where it gets long.
fn shortened(value: &Value) -> String {
    const LONGEST: usize = 120;
    let text = value.to_string();
    if text.chars().count() <= LONGEST {
        text
    } else {
        text.chars().take(LONGEST).collect::<String>() + "..."
    }
}

/// A line after the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
#[allow(clippy::large_enum_variant, reason = "nearly all entries are of the large one")]
pub enum Entry {
    /// A point was measured.
    Measured(Measured),
    /// A point, or a whole window, was given up.
    Failed(Failed),
}

/// What was given up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Failed {
    /// `scene/window`.
    pub window: String,
    /// The point; none is every point.
    pub point: Option<String>,
    /// The seed.
    pub seed: u64,
    /// Why.
    pub reason: String,
}

/// Name of the file in the folder of a sweep.
#[must_use]
pub fn journal_name(shard: Shard) -> String {
    format!("points-{}-of-{}.jsonl", shard.index, shard.count)
}

/// The file of one shard, to be added to.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    entries: Vec<Entry>,
    done: HashSet<(String, u64, String)>,
    /// Held as long as this lives.
    _lock: File,
}

impl Journal {
    /// Opens the file of a sweep in its folder, or makes it. A last line that was cut off is taken away, and what had failed, which
    /// is tried again.
    ///
    /// # Errors
    /// If the file cannot be read or written, holds points of another sweep, or another process is adding to it.
    pub fn open(folder: &Path, header: &Header) -> Result<Self, SweepError> {
        let path = folder.join(journal_name(header.shard));
        let lock = lock(&path)?;
        let mut entries = Vec::new();
        let mut text = line_of(&path, header)?.into_bytes();
        if path.exists() {
            let found = Found::read(&path)?;
            header.check(&path, &found.header)?;
            text = found.measured();
            entries = found.entries;
            entries.retain(|entry| matches!(entry, Entry::Measured(_)));
        }
        write_atomically(&path, |out| out.write_all(&text)).map_err(|error| SweepError::Io {
            action: "write",
            path: path.clone(),
            source: std::io::Error::other(error),
        })?;
        let file = OpenOptions::new().append(true).open(&path).map_err(io("write", &path))?;
        let done = entries.iter().filter_map(key_of).collect();
        Ok(Self { path, file, entries, done, _lock: lock })
    }

    /// Whether a point is measured.
    #[must_use]
    pub fn has(&self, window: &str, seed: u64, point: &str) -> bool {
        self.done.contains(&(window.to_owned(), seed, point.to_owned()))
    }

    /// How many runs are measured.
    #[must_use]
    pub fn measured(&self) -> usize {
        self.done.len()
    }

    /// What is measured, and what failed since the file was opened.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Refuses to go on with a window whose views are others than those that were measured.
    pub(super) fn check_data(&self, window: &str, data_sha256: &str) -> Result<(), SweepError> {
        let of_window = self.entries.iter().find_map(|entry| match entry {
            Entry::Measured(measured) if measured.window == window => Some(&measured.views.data_sha256),
            _ => None,
        });
        match of_window.filter(|found| *found != data_sha256) {
            Some(found) => Err(SweepError::OtherRecipe {
                path: self.path.clone(),
                key: format!("data_sha256 of {window}"),
                expected: data_sha256.to_owned(),
                found: found.clone(),
            }),
            None => Ok(()),
        }
    }

    /// Adds a line; it is on disk when this returns.
    pub(super) fn push(&mut self, entry: Entry) -> Result<(), SweepError> {
        let line = line_of(&self.path, &entry)?;
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data());
        written.map_err(io("write", &self.path))?;
        self.done.extend(key_of(&entry));
        self.entries.push(entry);
        Ok(())
    }
}

/// Keeps other processes from the file of a shard, where the file system has locks.
fn lock(path: &Path) -> Result<File, SweepError> {
    let path = path.with_extension("lock");
    match lock_file(&path) {
        Ok(Some(file)) => Ok(file),
        Ok(None) => Err(SweepError::Busy { path }),
        Err(source) => Err(SweepError::Io { action: "lock", path, source }),
    }
}

fn key_of(entry: &Entry) -> Option<(String, u64, String)> {
    match entry {
        Entry::Measured(measured) => Some((measured.window.clone(), measured.seed, measured.point.clone())),
        Entry::Failed(_) => None,
    }
}

fn io<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> SweepError + 'a {
    move |source| SweepError::Io { action, path: path.to_path_buf(), source }
}

fn line_of(path: &Path, value: &impl Serialize) -> Result<String, SweepError> {
    let json = serde_json::to_string(value).map_err(std::io::Error::from).map_err(io("write", path))?;
    Ok(json + "\n")
}

/// A file as it was found.
struct Found {
    path: PathBuf,
    header: Header,
    entries: Vec<Entry>,
    /// The lines as they lie there: of the header, then of each entry.
    lines: Vec<Vec<u8>>,
}

impl Found {
    fn read(path: &Path) -> Result<Self, SweepError> {
        let bytes = fs::read(path).map_err(io("read", path))?;
        let no_header = || SweepError::NoHeader { path: path.to_path_buf() };
        let mut lines = bytes.split_inclusive(|&byte| byte == b'\n').filter(|line| line.ends_with(b"\n"));
        let first = lines.next().ok_or_else(no_header)?;
        let header: Header = serde_json::from_slice(first).map_err(|_| no_header())?;
        if !header.shard.is_valid() {
            return Err(no_header());
        }
        let (mut entries, mut kept) = (Vec::new(), vec![first.to_vec()]);
        let rest: Vec<&[u8]> = lines.collect();
        for (i, line) in rest.iter().enumerate() {
            let refuse = |rule: String| SweepError::Line { path: path.to_path_buf(), line: i + 2, rule };
            match serde_json::from_slice::<Entry>(line) {
                Ok(entry) => {
                    header.knows(&entry).map_err(refuse)?;
                    entries.push(entry);
                    kept.push(line.to_vec());
                }
                // What a crash leaves at the end may be more than half a line.
                Err(_) if i + 1 == rest.len() => break,
                Err(_) => return Err(refuse("expected a measured point or a failure, as JSON".to_owned())),
            }
        }
        Ok(Self { path: path.to_path_buf(), header, entries, lines: kept })
    }

    /// The file without what failed and without what was cut off.
    fn measured(&self) -> Vec<u8> {
        let (header, rest) = self.lines.split_at(1);
        let measured = |entry: &Entry| matches!(entry, Entry::Measured(_));
        let kept = self.entries.iter().zip(rest).filter(|(entry, _)| measured(entry)).map(|(_, line)| line);
        header.iter().chain(kept).flatten().copied().collect()
    }

    /// Windows, seeds and points without a line, as a count; and of how many.
    fn open(&self) -> (usize, usize) {
        let Header { shard, windows, points, seeds, .. } = &self.header;
        let (mut behind, mut whole) = (HashSet::new(), HashSet::new());
        for entry in &self.entries {
            match entry {
                Entry::Measured(Measured { window, seed, point, .. }) => {
                    behind.insert((window, *seed, point));
                }
                Entry::Failed(Failed { window, seed, point: Some(point), .. }) => {
                    behind.insert((window, *seed, point));
                }
                Entry::Failed(Failed { window, point: None, .. }) => {
                    whole.insert(window);
                }
            }
        }
        let ours = windows.iter().enumerate().filter(|(position, _)| shard.takes(*position));
        let (mut open, mut all) = (0, 0);
        for (_, window) in ours {
            for point in points {
                for &seed in point.seeds(seeds) {
                    all += 1;
                    open += usize::from(
                        !whole.contains(window) && !behind.contains(&(window, seed, &point.point)),
                    );
                }
            }
        }
        (open, all)
    }
}

impl Header {
    /// The rule that an entry breaks, if it is not of this sweep.
    fn knows(&self, entry: &Entry) -> Result<(), String> {
        let (window, seed, point) = match entry {
            Entry::Measured(measured) => (&measured.window, measured.seed, Some(&measured.point)),
            Entry::Failed(failed) => (&failed.window, failed.seed, failed.point.as_ref()),
        };
        let position = self.windows.iter().position(|known| known == window);
        if !position.is_some_and(|position| self.shard.takes(position)) {
            return Err(format!("window {window:?} is not one of shard {}", self.shard));
        }
        match point {
            Some(point) if !self.points.iter().any(|known| known.point == *point) => {
                Err(format!("point {point:?} is not one of the recipe"))
            }
            Some(_) if !self.seeds.contains(&seed) => Err(format!("seed {seed} is not one of the recipe")),
            _ => Ok(()),
        }
    }
}

/// The files of all shards of a sweep.
#[derive(Debug)]
pub struct Shards {
    /// The sweep, as the first shard's file says it.
    pub header: Header,
    /// Everything measured, and what failed.
    pub entries: Vec<Entry>,
}

impl Shards {
    /// Reads all shards in some folders.
    ///
    /// # Errors
    /// If a folder has none, a file cannot be read or is of another recipe, a shard is there twice, is missing, or is not done.
    pub fn read(folders: &[PathBuf]) -> Result<Self, SweepError> {
        let mut files = Vec::new();
        for folder in folders {
            let entries = fs::read_dir(folder).map_err(io("read", folder))?;
            let is_journal = |path: &PathBuf| {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                name.starts_with("points-") && name.ends_with(".jsonl")
            };
            let paths = entries.map(|entry| entry.map(|entry| entry.path()));
            let paths = paths.collect::<Result<Vec<_>, _>>().map_err(io("read", folder))?;
            let before = files.len();
            for path in paths.into_iter().filter(is_journal) {
                files.push(Found::read(&path)?);
            }
            if files.len() == before {
                return Err(SweepError::NoJournal { path: folder.clone() });
            }
        }
        // Whatever order the folders list them in.
        files.sort_by_key(|file| file.header.shard.index);
        let mut of_shard: BTreeMap<usize, Found> = BTreeMap::new();
        let mut files = files.into_iter();
        let first =
            files.next().ok_or(SweepError::Missing { missing: vec!["no folder is given".to_owned()] })?;
        let header = first.header.clone();
        of_shard.insert(header.shard.index, first);
        for file in files {
            header.check(&file.path, &file.header)?;
            let (ours, theirs) = (header.shard.count, file.header.shard.count);
            if ours != theirs {
                let (expected, found) = (ours.to_string(), theirs.to_string());
                let key = "shard.count".to_owned();
                return Err(SweepError::OtherRecipe { path: file.path, key, expected, found });
            }
            let shard = file.header.shard;
            if let Some(twin) = of_shard.get(&shard.index) {
                return Err(SweepError::Twice {
                    a: twin.path.clone(),
                    b: file.path,
                    shard: shard.to_string(),
                });
            }
            of_shard.insert(shard.index, file);
        }
        let count = header.shard.count;
        let mut missing = Vec::new();
        for index in 0..count {
            match of_shard.get(&index).map(Found::open) {
                None => missing.push(format!("shard {index}/{count} is not there")),
                Some((0, _)) => {}
                Some((open, all)) => {
                    missing.push(format!(
                        "shard {index}/{count} has {} of {all} points: run it again to go on",
                        all - open
                    ));
                }
            }
        }
        if !missing.is_empty() {
            const LISTED: usize = 20;
            let more = missing.len().saturating_sub(LISTED);
            missing.truncate(LISTED);
            if more > 0 {
                missing.push(format!("{more} more"));
            }
            return Err(SweepError::Missing { missing });
        }
        let entries = of_shard.into_values().flat_map(|file| file.entries).collect();
        Ok(Self { header: Header { shard: Shard::WHOLE, ..header }, entries })
    }
}

#[cfg(test)]
#[path = "journal_tests.rs"]
pub(super) mod tests;
