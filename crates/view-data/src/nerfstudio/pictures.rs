//! Finds a picture that is not at its `file_path`.

use crate::ImageSource;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What Blender-style files leave out.
const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

/// Finds the pictures of a data set.
pub(super) struct Pictures<'a> {
    root: &'a Path,
    /// The one folder that has the pictures, whatever folder `file_path` names.
    only: Option<&'a Path>,
    /// The `images*` folders of the root and the names in them; listed on the first miss.
    folders: Option<BTreeMap<PathBuf, BTreeSet<String>>>,
}

impl<'a> Pictures<'a> {
    pub(super) fn new(root: &'a Path, only: Option<&'a Path>) -> Self {
        Self { root, only, folders: None }
    }

    /// A path of the file relative to its folder; absolute paths stay. `\` separates as `/` does.
    pub(super) fn beside(&self, path: &str) -> PathBuf {
        self.root.join(path.replace('\\', "/"))
    }

    /// The picture that `file_path` means: as it stands, with a picture's extension added, or by its name in the one
    /// `images*` folder that has it (DL3DV names `images` and ships `images_4` or `images_8`).
    ///
    /// The error lists the folders if several have it.
    pub(super) fn find(&mut self, file_path: &str) -> Result<ImageSource, Vec<String>> {
        let mut stated = self.beside(file_path);
        if let (Some(folder), Some(name)) = (self.only, stated.file_name()) {
            stated = folder.join(name);
        }
        if let Some(path) = variants(&stated).find(|path| path.is_file()) {
            return Ok(ImageSource::File(path));
        }
        let name = stated.file_name().filter(|_| self.only.is_none());
        let Some(name) = name.map(PathBuf::from) else {
            return Ok(ImageSource::Missing(stated));
        };
        let folders = self.folders.get_or_insert_with(|| images_folders(self.root));
        let found = folders.iter().filter_map(|(folder, names)| {
            let name = variants(&name).find(|name| names.contains(name.to_string_lossy().as_ref()))?;
            Some((folder, name))
        });
        let found: Vec<_> = found.collect();
        match found.as_slice() {
            [] => Ok(ImageSource::Missing(stated)),
            [(folder, name)] => Ok(ImageSource::File(folder.join(name))),
            several => Err(several.iter().map(|(folder, _)| folder.display().to_string()).collect()),
        }
    }
}

/// The path, then the path with each extension added (not exchanged: a stem may hold a dot).
fn variants(path: &Path) -> impl Iterator<Item = PathBuf> {
    let extended = EXTENSIONS.iter().map(move |extension| {
        let mut name = path.as_os_str().to_os_string();
        name.push(".");
        name.push(extension);
        PathBuf::from(name)
    });
    std::iter::once(path.to_path_buf()).chain(extended)
}

fn images_folders(root: &Path) -> BTreeMap<PathBuf, BTreeSet<String>> {
    // A folder that cannot be listed offers no pictures; the frame is then reported missing.
    let list = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let folders = list(root).map(|entry| entry.path());
    let folders = folders.filter(|path| {
        path.is_dir() && path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("images"))
    });
    let names = |folder: &PathBuf| {
        list(folder).map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    };
    folders.map(|folder| (folder.clone(), names(&folder))).collect()
}
