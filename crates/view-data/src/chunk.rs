//! pixelSplat's chunks: `torch.save` of a list of scenes, each with its cameras and its encoded pictures.

mod rule;

pub use rule::ChunkRule;

use crate::camera_row::{COLUMNS, read_row};
use crate::scene_list::{SceneEntry, SceneList};
use crate::{Dataset, Dropped, Error, Format, Frame, ImageSource, Result, Scenes};
use ChunkRule as Rule;
pub(crate) use rule::is_name;
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use tensor_files::{Dtype, Tensor, TorchFile, Value};

/// Opens every scene of `path`, see [`list_chunks`]; a scene that breaks a rule is listed as dropped. For a large data
/// set, list the scenes and open them one by one.
///
/// # Errors
/// As [`list_chunks`].
pub fn open_chunks(path: &Path) -> Result<Scenes> {
    Ok(list_chunks(path)?.open_all())
}

/// Lists the scenes of `path`: a `.torch` file, a folder of them, or a folder with `test/` or `train/` in which they
/// are. With an `index.json` (`{"scene": "000000.torch"}`) no chunk is opened; scenes whose chunk is not there, and
/// chunks that the index does not name, are listed as dropped.
///
/// # Errors
/// If nothing of that kind lies there, an `index.json` breaks its rules, or `path` is a file and cannot be read.
pub fn list_chunks(path: &Path) -> Result<SceneList> {
    let mut list = SceneList::new(Format::Chunk);
    if path.is_file() {
        list_file(path, &mut list)?;
    } else {
        for folder in stages(path, holds_chunks) {
            list_folder(&folder, &mut list)?;
        }
    }
    list.finish(path)
}

/// The folder itself, or those of its `test/` and `train/` that hold what is looked for.
pub(crate) fn stages(root: &Path, holds: impl Fn(&Path) -> bool) -> Vec<PathBuf> {
    if holds(root) {
        return vec![root.to_path_buf()];
    }
    ["test", "train"].map(|stage| root.join(stage)).into_iter().filter(|folder| holds(folder)).collect()
}

/// Whether chunks lie at a path. None is opened.
pub(crate) fn is_there(path: &Path) -> bool {
    let is_chunk = path.is_file() && path.extension().is_some_and(|extension| extension == "torch");
    is_chunk || !stages(path, holds_chunks).is_empty()
}

/// Whether chunk files lie in a folder.
fn holds_chunks(folder: &Path) -> bool {
    chunk_files(folder).is_ok_and(|files| !files.is_empty())
}

/// The `.torch` files of a folder, sorted by name.
fn chunk_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |source| Error::Read { path: folder.to_path_buf(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|extension| extension == "torch") && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn list_folder(folder: &Path, list: &mut SceneList) -> Result<()> {
    let files = chunk_files(folder)?;
    let index = folder.join("index.json");
    if !index.is_file() {
        for file in &files {
            if let Err(error) = list_file(file, list) {
                list.dropped.push(Dropped::failed(file.display().to_string(), &error));
            }
        }
        return Ok(());
    }
    let mut unnamed: HashSet<&PathBuf> = files.iter().collect();
    for (name, file) in crate::index::read_entries(&index)? {
        let broken = |rule| Error::Chunk { path: index.clone(), place: clipped(&name), rule };
        let file =
            file.as_str().ok_or_else(|| broken(Rule::IndexEntry { found: clipped(&file.to_string()) }))?;
        if !is_name(file) {
            return Err(broken(Rule::IndexEntry { found: clipped(file) }));
        }
        if !is_name(&name) {
            return Err(broken(Rule::Name { found: clipped(&name) }));
        }
        let path = folder.join(file);
        unnamed.remove(&path);
        if path.is_file() {
            list.entries.push(SceneEntry { name, path });
        } else {
            list.dropped.push(Dropped::new(name, format!("chunk missing: {}", path.display())));
        }
    }
    let unnamed: BTreeMap<_, _> = unnamed.into_iter().map(|path| (path, ())).collect();
    for path in unnamed.into_keys() {
        let reason = format!("{} names no scene of it", index.display());
        list.dropped.push(Dropped::new(path.display().to_string(), reason));
    }
    Ok(())
}

fn list_file(path: &Path, list: &mut SceneList) -> Result<()> {
    let chunk = Chunk::open(path)?;
    let entry = |(name, _): &(String, Value)| SceneEntry { name: name.clone(), path: path.to_path_buf() };
    list.entries.extend(chunk.scenes.iter().map(entry));
    list.dropped.extend(chunk.dropped);
    list.opened.insert(path.to_path_buf());
    Ok(())
}

/// An open chunk: scenes are known by name, and decoded one at a time.
pub(crate) struct Chunk {
    torch: TorchFile,
    scenes: Vec<(String, Value)>,
    dropped: Vec<Dropped>,
    /// Bytes of the images of the scenes that were decoded. Together they are no longer than the file, or many scenes
    /// could list the same images again and again.
    image_bytes: u64,
}

impl Chunk {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let torch = TorchFile::open(path)?;
        let broken =
            |place: &str, rule| Error::Chunk { path: path.to_path_buf(), place: place.to_owned(), rule };
        let pickle = torch.pickle();
        let root = pickle.root();
        let items = pickle.items(root);
        let items = items.ok_or_else(|| broken("", Rule::NotScenes { found: root.type_name() }))?;
        let (found, length) = (items.len(), torch.length());
        if found as u64 > length / SHORTEST_PICTURE {
            return Err(broken("", Rule::TooManyScenes { found, length }));
        }
        let (mut scenes, mut dropped) = (Vec::new(), Vec::new());
        let (mut seen, mut names) = (HashSet::new(), HashSet::new());
        for (position, &scene) in items.iter().enumerate() {
            // A list may hold one scene many times; it is searched once.
            let is_new = scene.dict().is_none_or(|dict| seen.insert(dict));
            let name = if is_new { scene_name(&torch, scene) } else { Err(Rule::DuplicateScene) };
            match name {
                Ok(name) if names.insert(name) => scenes.push((name.to_owned(), scene)),
                result => {
                    let place = format!("scene {position}");
                    let error = broken(&place, result.err().unwrap_or(Rule::DuplicateScene));
                    dropped.push(Dropped::failed(place, &error));
                }
            }
        }
        drop(names);
        Ok(Self { torch, scenes, dropped, image_bytes: 0 })
    }

    /// What the chunk lists and is no scene; only once.
    pub(crate) fn take_dropped(&mut self) -> Vec<Dropped> {
        std::mem::take(&mut self.dropped)
    }

    /// The scene of a name.
    pub(crate) fn find(&mut self, name: &str) -> Result<Dataset> {
        match self.scenes.iter().position(|(known, _)| known == name) {
            Some(position) => self.dataset(position),
            None => {
                let (path, place) = (self.torch.path().to_path_buf(), name.to_owned());
                Err(Error::Chunk { path, place, rule: Rule::UnknownScene })
            }
        }
    }

    /// Reads the cameras of a scene and the sizes of its pictures.
    fn dataset(&mut self, position: usize) -> Result<Dataset> {
        let path = self.torch.path().to_path_buf();
        let broken = |place: &str, rule| Error::Chunk { path: path.clone(), place: place.to_owned(), rule };
        let (name, scene) = self.scenes[position].clone();
        let name = name.as_str();
        let parts = Parts::new(&self.torch, scene).map_err(|rule| broken(name, rule))?;
        let views = parts.images.len();

        let names = match parts.timestamps {
            Some(timestamps) => frame_names(&self.torch.integers(&timestamps)?),
            None => (0..views).map(|position| position.to_string()).collect(),
        };
        let rows = self.torch.numbers(&parts.cameras)?;
        let mut frames = Vec::with_capacity(views);
        for ((position, image), frame) in parts.images.iter().enumerate().zip(names) {
            let (offset, length) = self.torch.locate(image)?;
            let place = format!("{name}: frame {position} ({frame})");
            if length < SHORTEST_PICTURE {
                return Err(broken(&place, Rule::ImageLength { found: length }));
            }
            self.image_bytes = self.image_bytes.saturating_add(length);
            if self.image_bytes > self.torch.length() {
                return Err(broken(name, Rule::ImagesOverlap));
            }
            let image = ImageSource::Encoded { path: path.clone(), offset, length };
            let size = crate::picture::size(&image, &frame)?;
            let mut row = [0.0; COLUMNS];
            row.copy_from_slice(&rows[position * COLUMNS..][..COLUMNS]);
            let camera = read_row(&row, size).map_err(|rule| broken(&place, Rule::Camera(rule)))?;
            frames.push(Frame::of_row(frame, image, camera));
        }
        let root = path.parent().map(Path::to_path_buf).unwrap_or_default();
        let mut dataset = Dataset::new(Format::Chunk, name.to_owned(), path, root, frames);
        dataset.url = parts.url;
        Ok(dataset)
    }
}

/// Bytes of the smallest PNG file; a JPEG is longer.
const SHORTEST_PICTURE: u64 = 67;
/// Longest `url` that is kept, bytes.
const MAX_URL: usize = 2048;

fn scene_name(torch: &TorchFile, scene: Value) -> std::result::Result<&str, Rule> {
    let pickle = torch.pickle();
    if !pickle.is_dict(scene) {
        return Err(Rule::Type { what: "the scene", expected: "dict", found: scene.type_name() });
    }
    let key = pickle.get(scene, "key").ok_or(Rule::MissingKey { key: "key" })?;
    let Value::Text(_) = key else {
        return Err(Rule::Type { what: "key", expected: "str", found: key.type_name() });
    };
    let name = pickle.text(key).ok_or(Rule::Name { found: "a long text".to_owned() })?;
    if is_name(name) { Ok(name) } else { Err(Rule::Name { found: clipped(name) }) }
}

/// What a scene is made of: types, shapes and counts agree.
struct Parts {
    cameras: Tensor,
    timestamps: Option<Tensor>,
    images: Vec<Tensor>,
    url: Option<String>,
}

impl Parts {
    fn new(torch: &TorchFile, scene: Value) -> std::result::Result<Self, Rule> {
        let pickle = torch.pickle();
        let key = |key| pickle.get(scene, key).ok_or(Rule::MissingKey { key });
        let tensor = |what, value: Value, expected, types: &[Dtype]| {
            let tensor = pickle.tensor(value).filter(|tensor| types.contains(&tensor.dtype()));
            tensor.copied().ok_or(Rule::Type { what, expected, found: value.type_name() })
        };

        let list = key("images")?;
        let wrong = Rule::Type { what: "images", expected: "a list of tensors", found: list.type_name() };
        let list = pickle.items(list).ok_or(wrong)?;
        if list.is_empty() {
            return Err(Rule::NoImages);
        }
        // As many images as the file can hold; the rest cannot be pictures.
        if list.len() as u64 > torch.length() / SHORTEST_PICTURE {
            return Err(Rule::ImagesOverlap);
        }
        let mut images = Vec::with_capacity(list.len());
        for &image in list {
            let image = tensor("an image", image, "a uint8 tensor", &[Dtype::U8])?;
            if image.shape().len() != 1 || !image.is_contiguous() {
                return Err(Rule::ImageShape { shape: image.shape().to_vec() });
            }
            images.push(image);
        }

        let expected = "a float32 or float64 tensor";
        let cameras = tensor("cameras", key("cameras")?, expected, &[Dtype::F32, Dtype::F64])?;
        let &[count, columns] = cameras.shape() else {
            return Err(Rule::CameraShape { found: cameras.shape().to_vec() });
        };
        if columns != COLUMNS as u64 {
            return Err(Rule::CameraShape { found: cameras.shape().to_vec() });
        }
        let agree = |what, found| {
            let images = images.len();
            if found == images as u64 { Ok(()) } else { Err(Rule::Count { what, found, images }) }
        };
        agree("cameras", count)?;
        let timestamps = match pickle.get(scene, "timestamps") {
            None | Some(Value::None) => None,
            Some(value) => {
                let timestamps = tensor("timestamps", value, "an int64 tensor", &[Dtype::I64])?;
                let &[count] = timestamps.shape() else {
                    let (expected, found) = ("a tensor of shape [views]", "a tensor of another shape");
                    return Err(Rule::Type { what: "timestamps", expected, found });
                };
                agree("timestamps", count)?;
                Some(timestamps)
            }
        };
        let url = pickle.get(scene, "url").and_then(|url| pickle.text(url));
        let url = url.filter(|url| !url.is_empty() && url.len() <= MAX_URL).map(str::to_owned);
        Ok(Self { cameras, timestamps, images, url })
    }
}

/// Timestamps as names, or positions where a timestamp occurs twice.
fn frame_names(timestamps: &[i64]) -> Vec<String> {
    let distinct: HashSet<_> = timestamps.iter().collect();
    if distinct.len() == timestamps.len() {
        return timestamps.iter().map(ToString::to_string).collect();
    }
    (0..timestamps.len()).map(|position| position.to_string()).collect()
}

/// A name of a file, cut to what fits into a message.
fn clipped(name: &str) -> String {
    name.chars().take(rule::MAX_NAME).collect()
}
