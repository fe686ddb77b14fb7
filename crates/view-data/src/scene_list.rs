//! Lists of scenes, known by name before any of them is opened.

use crate::chunk::Chunk;
use crate::{Dataset, Dropped, Error, Format, Result, Scenes};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// The scenes of a data set of many, listed by [`list_chunks`](crate::list_chunks), [`list_dl3dv`](crate::list_dl3dv)
/// or [`list_re10k`](crate::list_re10k). An evaluation index names them by [`SceneEntry::name`].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SceneList {
    /// The layout.
    pub format: Format,
    /// The scenes in the order of their names, each name once.
    pub entries: Vec<SceneEntry>,
    /// What lies there and makes no scene, and why.
    pub dropped: Vec<Dropped>,
    /// Chunks that were opened to list them: what they leave out is in `dropped`.
    pub(crate) opened: HashSet<PathBuf>,
}

/// A scene that was not opened yet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneEntry {
    /// Its name, as an evaluation index has it: the key of a chunk or a camera file, the hash of a DL3DV scene.
    pub name: String,
    /// The chunk, the folder or the camera file that holds it.
    pub path: PathBuf,
}

impl SceneList {
    pub(crate) fn new(format: Format) -> Self {
        Self { format, entries: Vec::new(), dropped: Vec::new(), opened: HashSet::new() }
    }

    /// Sorts the scenes, drops all but the first of a name, and refuses a list that is empty.
    pub(crate) fn finish(mut self, root: &Path) -> Result<Self> {
        self.entries.sort_by(|a, b| a.name.cmp(&b.name));
        let mut entries: Vec<SceneEntry> = Vec::with_capacity(self.entries.len());
        for entry in self.entries {
            match entries.last() {
                Some(last) if last.name == entry.name => {
                    let reason = format!("{} has it too: {}", entry.path.display(), last.path.display());
                    self.dropped.push(Dropped::new(entry.name, reason));
                }
                _ => entries.push(entry),
            }
        }
        if entries.is_empty() && self.dropped.is_empty() {
            return Err(crate::open::no_layout(root, Some(self.format)));
        }
        Ok(Self { entries, ..self })
    }

    /// Opens one scene.
    ///
    /// # Errors
    /// If there is no scene of that name, or it breaks a rule of its format.
    pub fn open(&self, name: &str) -> Result<Dataset> {
        let found = self.entries.binary_search_by(|entry| entry.name.as_str().cmp(name));
        let found = found.map_err(|_| Error::UnknownScene {
            name: name.to_owned(),
            format: self.format,
            scenes: self.entries.len(),
        })?;
        let path = &self.entries[found].path;
        match self.format {
            Format::Chunk => Chunk::open(path)?.find(name),
            Format::Dl3dv => crate::dl3dv::open_scene(path, name),
            _ => crate::re10k::open_scene(path, name),
        }
    }

    /// Opens all scenes; those that break a rule are listed as dropped.
    #[must_use]
    pub fn open_all(mut self) -> Scenes {
        let mut scenes: Vec<(usize, Dataset)> = Vec::new();
        let mut by_path: BTreeMap<&Path, Vec<usize>> = BTreeMap::new();
        for (position, entry) in self.entries.iter().enumerate() {
            by_path.entry(&entry.path).or_default().push(position);
        }
        for (path, positions) in by_path {
            let mut chunk = None;
            if self.format == Format::Chunk {
                match Chunk::open(path) {
                    Ok(mut open) => {
                        // An index does not know what the chunk itself leaves out.
                        if !self.opened.contains(path) {
                            self.dropped.append(&mut open.take_dropped());
                        }
                        chunk = Some(open);
                    }
                    Err(error) => {
                        let failed =
                            |&position: &usize| Dropped::failed(self.entries[position].name.clone(), &error);
                        self.dropped.extend(positions.iter().map(failed));
                        continue;
                    }
                }
            }
            for position in positions {
                let name = &self.entries[position].name;
                let scene = chunk.as_mut().map_or_else(|| self.open(name), |chunk| chunk.find(name));
                match scene {
                    Ok(scene) => scenes.push((position, scene)),
                    Err(error) => self.dropped.push(Dropped::failed(name.clone(), &error)),
                }
            }
        }
        scenes.sort_by_key(|&(position, _)| position);
        Scenes { scenes: scenes.into_iter().map(|(_, scene)| scene).collect(), dropped: self.dropped }
    }
}
