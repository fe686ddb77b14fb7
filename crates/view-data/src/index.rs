//! The evaluation index: which views of a scene are given and which are held out.

mod rule;

pub use rule::IndexRule;

use crate::{Dataset, Dropped, Error, Result, WriteRule};
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// An evaluation index in pixelSplat's layout: `{"scene/window": {"context": [..], "target": [..]}, ..}` with
/// positions in the scene's list of frames. Keys without `/` are scenes with one window; further keys of an entry
/// are ignored.
#[derive(Debug, Clone, PartialEq)]
pub struct EvaluationIndex {
    /// The file.
    pub path: PathBuf,
    /// The windows, sorted by scene, then by window (numbers by value, before words).
    pub windows: Vec<Window>,
    /// Entries without a window (null in the file), in the same order.
    pub dropped: Vec<Dropped>,
}

/// One evaluation: the context views go in, the targets are compared.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// The whole key, `scene/window`.
    pub key: String,
    /// The part before the last `/`; the whole key if there is none.
    pub scene: String,
    /// Positions of the views that are given.
    pub context: Vec<usize>,
    /// Positions of the views that are compared; what is not in `context` is held out.
    pub target: Vec<usize>,
}

impl Window {
    /// Targets that are context views too, in the order of `target`. That is allowed, but no measure of new views.
    #[must_use]
    pub fn overlap(&self) -> Vec<usize> {
        self.target.iter().copied().filter(|position| self.context.contains(position)).collect()
    }
}

impl EvaluationIndex {
    /// The windows of a data set, found by its name, with all positions checked against its frames.
    ///
    /// # Errors
    /// If the index has no window for it, or names a position that it has not.
    pub fn windows_of(&self, dataset: &Dataset) -> Result<Vec<&Window>> {
        let broken = |key: &str, rule| Error::Index { path: self.path.clone(), key: key.to_owned(), rule };
        let windows: Vec<_> = self.windows.iter().filter(|window| window.scene == dataset.name).collect();
        if windows.is_empty() {
            let mut known: Vec<_> = self.windows.iter().map(|window| window.scene.clone()).collect();
            known.dedup();
            return Err(broken("", IndexRule::UnknownScene { scene: dataset.name.clone(), known }));
        }
        let frames = dataset.frames.len();
        for window in &windows {
            for (list, positions) in [("context", &window.context), ("target", &window.target)] {
                if let Some(&position) = positions.iter().find(|&&position| position >= frames) {
                    let scene = dataset.name.clone();
                    return Err(broken(&window.key, IndexRule::Position { list, position, scene, frames }));
                }
            }
        }
        Ok(windows)
    }
}

/// Reads an evaluation index.
///
/// # Errors
/// If the file cannot be read, is not in the layout, or an entry is empty or names a position twice.
pub fn read_index(path: &Path) -> Result<EvaluationIndex> {
    let broken = |key: &str, rule| Error::Index { path: path.to_path_buf(), key: key.to_owned(), rule };
    let entries = read_entries(path)?;
    let mut index = EvaluationIndex { path: path.to_path_buf(), windows: Vec::new(), dropped: Vec::new() };
    for (key, value) in entries {
        if value.is_null() {
            index.dropped.push(Dropped::new(key, "the index has no window for it (null)"));
            continue;
        }
        let list = |list| positions(&value, list).map_err(|rule| broken(&key, rule));
        let (context, target) = (list("context")?, list("target")?);
        let scene = split(&key).0.to_owned();
        index.windows.push(Window { key, scene, context, target });
    }
    Ok(index)
}

/// Writes windows in the layout that [`read_index`] reads.
///
/// # Errors
/// If the file cannot be written.
pub fn write_index(path: &Path, windows: &[Window]) -> Result<()> {
    let entry =
        |window: &Window| (window.key.clone(), json!({ "context": window.context, "target": window.target }));
    let entries: serde_json::Map<String, Value> = windows.iter().map(entry).collect();
    let text = format!("{:#}", Value::Object(entries));
    gs_scene::write_atomically(path, |out| out.write_all(text.as_bytes()))
        .map_err(|source| Error::Write { path: path.to_path_buf(), rule: WriteRule::File(source) })
}

/// The entries of a JSON object in the order of [`sort_key`]; there is at least one, and each key occurs once.
pub(crate) fn read_entries(path: &Path) -> Result<Vec<(String, Value)>> {
    let text = crate::files::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    let broken = |key: &str, rule| Error::Index { path: path.to_path_buf(), key: key.to_owned(), rule };
    let Entries(mut entries) =
        serde_json::from_slice(&text).map_err(|source| Error::Json { path: path.to_path_buf(), source })?;
    if entries.is_empty() {
        return Err(broken("", IndexRule::Empty));
    }
    entries.sort_by_cached_key(|(key, _)| sort_key(key));
    if let Some(pair) = entries.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(broken(&pair[0].0, IndexRule::DuplicateKey));
    }
    Ok(entries)
}

fn positions(entry: &Value, list: &'static str) -> std::result::Result<Vec<usize>, IndexRule> {
    let values = entry.get(list).and_then(Value::as_array).ok_or(IndexRule::Entry)?;
    if values.is_empty() {
        return Err(IndexRule::EmptyList { list });
    }
    let mut seen = HashSet::new();
    let position = |value: &Value| {
        let position = value.as_u64().and_then(|position| usize::try_from(position).ok());
        let position = position.ok_or(IndexRule::Entry)?;
        if seen.insert(position) { Ok(position) } else { Err(IndexRule::Duplicate { list, position }) }
    };
    values.iter().map(position).collect()
}

/// Scene and window of a key.
fn split(key: &str) -> (&str, &str) {
    key.rsplit_once('/').unwrap_or((key, ""))
}

/// `fox/2` before `fox/10`; the key itself last, so that only equal keys are equal.
fn sort_key(key: &str) -> (String, u64, String) {
    let (scene, window) = split(key);
    (scene.to_owned(), window.parse().unwrap_or(u64::MAX), key.to_owned())
}

/// A JSON object with its keys as they stand: a map would keep one of two equal keys and say nothing.
struct Entries(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Entries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Collect;
        impl<'de> Visitor<'de> for Collect {
            type Value = Entries;
            fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
                formatter.write_str("an object with a key per scene")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> std::result::Result<Entries, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(Collect)
    }
}
