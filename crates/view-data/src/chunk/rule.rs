//! Rules of chunks.

use crate::CameraRule;

/// The rules of a chunk, or of the `index.json` beside it, that can be broken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ChunkRule {
    /// The file holds something else than a list of scenes.
    #[error("holds {found}, expected a list of scenes")]
    NotScenes {
        /// What it holds.
        found: &'static str,
    },
    /// More scenes than the file can hold pictures.
    #[error("lists {found} scenes, more than a file of {length} bytes can hold")]
    TooManyScenes {
        /// How many it lists.
        found: usize,
        /// Bytes of the file.
        length: u64,
    },
    /// A key of a scene that is absent.
    #[error("key {key:?} is missing")]
    MissingKey {
        /// The key.
        key: &'static str,
    },
    /// A value of the wrong type.
    #[error("{what} is {found}, expected {expected}")]
    Type {
        /// The key, or the place.
        what: &'static str,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: &'static str,
    },
    /// A name of a scene that cannot name a file.
    #[error(
        "name of the scene is {found:?}, expected 1 to {MAX_NAME} printable characters other than / and \\"
    )]
    Name {
        /// The name, cut.
        found: String,
    },
    /// Two scenes of one name.
    #[error("a scene of this name comes before")]
    DuplicateScene,
    /// Cameras that are no `[views, 18]`.
    #[error("cameras have shape {found:?}, expected [views, 18]")]
    CameraShape {
        /// Their shape.
        found: Vec<u64>,
    },
    /// Lists of different lengths.
    #[error("{what} are {found}, but there are {images} images")]
    Count {
        /// `cameras` or `timestamps`.
        what: &'static str,
        /// How many there are.
        found: u64,
        /// How many images there are.
        images: usize,
    },
    /// A scene without pictures.
    #[error("has no images")]
    NoImages,
    /// An image that is no row of bytes.
    #[error("image is a tensor of shape {shape:?}, expected contiguous uint8 [bytes] (the PNG or JPEG file)")]
    ImageShape {
        /// Its shape.
        shape: Vec<u64>,
    },
    /// An image too short for a PNG or JPEG file.
    #[error("image has {found} bytes, too few for a PNG or JPEG file")]
    ImageLength {
        /// Its bytes.
        found: u64,
    },
    /// Images that share bytes.
    #[error("images of the chunk are longer than the file: they lie over each other")]
    ImagesOverlap,
    /// A camera breaks a rule.
    #[error("{0}")]
    Camera(CameraRule),
    /// A scene that is asked for is not there.
    #[error("no such scene in this chunk")]
    UnknownScene,
    /// `index.json` names something else than a file beside it.
    #[error("index names {found:?}, expected the name of a chunk file beside it")]
    IndexEntry {
        /// What it names.
        found: String,
    },
}

/// Longest name of a scene, characters.
pub(crate) const MAX_NAME: usize = 128;

/// Whether a name can be that of a file everywhere.
pub(crate) fn is_name(name: &str) -> bool {
    let allowed = |c: char| !c.is_control() && c != '/' && c != '\\';
    let short = (1..=MAX_NAME).contains(&name.chars().count());
    short && name.chars().all(allowed) && name != "." && name != ".."
}
