//! Finds the pictures of a model, which has only their names.

use crate::ImageSource;
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// Folders of pictures, from a scene's folder; larger ones first.
const FOLDERS: [&str; 6] = ["images", "images_2", "images_4", "images_8", "input", ""];
const EXTENSIONS: [&str; 6] = ["jpg", "png", "jpeg", "JPG", "PNG", "JPEG"];

/// Finds pictures by their names in the model.
pub(super) struct Pictures {
    /// The scene's folder.
    root: PathBuf,
    /// Candidates, the one where the last picture was found in front.
    folders: Vec<PathBuf>,
    /// Where pictures were found.
    used: BTreeSet<PathBuf>,
}

impl Pictures {
    /// `model` is the folder of the model, `path` what the user named.
    pub(super) fn new(model: &Path, path: &Path) -> Self {
        let roots = super::picture_roots(model, path);
        let has_images = |root: &&PathBuf| FOLDERS[..5].iter().any(|folder| root.join(folder).is_dir());
        let root = roots.iter().find(has_images).unwrap_or(&roots[0]).clone();
        let folders = FOLDERS.iter().map(|folder| root.join(folder)).collect();
        Self { root, folders, used: BTreeSet::new() }
    }

    pub(super) fn root(&self) -> PathBuf {
        self.root.clone()
    }

    pub(super) fn find(&mut self, name: &str) -> ImageSource {
        for (place, folder) in self.folders.iter().enumerate() {
            let stated = folder.join(name);
            let others = EXTENSIONS.iter().map(|extension| stated.with_extension(extension));
            let found = std::iter::once(stated.clone()).chain(others).find(|path| path.is_file());
            if let Some(found) = found {
                self.used.insert(found.parent().unwrap_or(folder).to_path_buf());
                // Most models have all pictures in one folder: the next is looked for there first.
                self.folders[..=place].rotate_right(1);
                return ImageSource::File(found);
            }
        }
        ImageSource::Missing(self.root.join(FOLDERS[0]).join(name))
    }

    /// Pictures that lie beside the found ones and that no name of the model means, in order.
    pub(super) fn unregistered<'a>(&self, names: impl Iterator<Item = &'a str>) -> Vec<String> {
        let stem = |path: &Path| path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let known: HashSet<_> = names.map(|name| stem(Path::new(name))).collect();
        let mut found = Vec::new();
        for folder in &self.used {
            // A folder that cannot be listed has given its pictures already.
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                let is_picture = path.extension().is_some_and(|extension| {
                    EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known))
                });
                if is_picture && !known.contains(&stem(&path)) {
                    found.push(path.file_name().unwrap_or_default().to_string_lossy().into_owned());
                }
            }
        }
        found.sort();
        found
    }
}
