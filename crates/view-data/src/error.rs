//! Errors: one enum for the crate, and one for the rules of each kind of file.

mod format;
mod pose;
mod transforms;

use crate::{Dropped, ImageSource};
use std::path::PathBuf;

pub use format::{FormatRule, Place};
pub use pose::PoseRule;
pub use transforms::TransformsRule;

/// What can be wrong with a data set, its files, an evaluation index or a selection of views.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A data set cannot be written.
    #[error("{}: the data set cannot be written", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        #[source]
        rule: crate::WriteRule,
    },
    /// A file or folder cannot be read.
    #[error("{}: cannot read", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// No layout of files that is read lies there.
    #[error("{}: no data set found; looked for {}", path.display(), looked_for.join("; "))]
    NoLayout {
        /// The file or folder.
        path: PathBuf,
        /// Each format and the files by which it is recognised.
        looked_for: Vec<String>,
    },
    /// Pictures without poses, or what pictures could be made of.
    #[error("{}: {found}; poses were looked for in {}", path.display(), looked_for.join("; "))]
    NoPoses {
        /// The file or folder.
        path: PathBuf,
        /// What lies there.
        found: crate::Unposed,
        /// Each format and the files by which it is recognised.
        looked_for: Vec<String>,
    },
    /// Several scenes, or none that can be read, where one is asked for.
    #[error("{}: expected one scene, found {}; give the folder of one", path.display(), scenes(names, dropped))]
    NotOneScene {
        /// The file or folder.
        path: PathBuf,
        /// The scenes.
        names: Vec<String>,
        /// Scenes that cannot be read, and why.
        dropped: Vec<Dropped>,
    },
    /// A format that is not known.
    #[error(
        "format {found:?} is not known, expected one of {}",
        crate::Format::ALL.map(crate::Format::name).join(", ")
    )]
    UnknownFormat {
        /// The name.
        found: String,
    },
    /// A file is not JSON, or ends too early.
    #[error("{}: not valid JSON", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Line, column and reason.
        #[source]
        source: serde_json::Error,
    },
    /// A `transforms.json`, or another JSON file of a camera, breaks a rule of its format.
    #[error("{}: {}{rule}", path.display(), place(frame.as_deref()))]
    Transforms {
        /// The file.
        path: PathBuf,
        /// Position and `file_path` of the frame; `None` if the rule concerns the whole file.
        frame: Option<String>,
        /// The rule, with expected and found.
        rule: TransformsRule,
    },
    /// A file of `torch.save` breaks a rule of its format.
    #[error("{}: {rule}", path.display())]
    Torch {
        /// The file.
        path: PathBuf,
        /// The rule, with expected and found.
        rule: crate::TorchRule,
    },
    /// A chunk of scenes, or the `index.json` beside it, breaks a rule of its format.
    #[error("{}: {}{rule}", path.display(), prefix(place))]
    Chunk {
        /// The file.
        path: PathBuf,
        /// Scene and frame; empty if the rule concerns the whole file.
        place: String,
        /// The rule, with expected and found.
        rule: crate::ChunkRule,
    },
    /// A DL3DV folder breaks a rule of its layout.
    #[error("{}: {}{rule}", path.display(), place(frame.as_deref()))]
    Dl3dv {
        /// The folder.
        path: PathBuf,
        /// Name of the frame; `None` if the rule concerns the whole scene.
        frame: Option<String>,
        /// The rule, with expected and found.
        rule: crate::Dl3dvRule,
    },
    /// A camera file of RealEstate10K breaks a rule of its format.
    #[error("{}: {}{rule}", path.display(), line.map_or_else(String::new, |line| format!("line {line}: ")))]
    Re10k {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1; `None` if the rule concerns the whole file.
        line: Option<usize>,
        /// The rule, with expected and found.
        rule: crate::Re10kRule,
    },
    /// A scene that a list of scenes does not have.
    #[error("no scene {name:?} among the {scenes} of this {format} data set")]
    UnknownScene {
        /// The name asked for.
        name: String,
        /// The layout.
        format: crate::Format,
        /// How many scenes there are.
        scenes: usize,
    },
    /// A text or binary file breaks a rule of its format.
    #[error("{}: {place}{rule}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: Place,
        /// The rule, with expected and found.
        rule: FormatRule,
    },
    /// A frame position beyond the data set.
    #[error("frame position {position} does not exist: {name} has {frames} frames (0 to {})", frames.saturating_sub(1))]
    Position {
        /// Name of the data set.
        name: String,
        /// The position asked for.
        position: usize,
        /// Frames in the data set.
        frames: usize,
    },
    /// The picture of a frame is not there.
    #[error(
        "{}: picture of frame {frame} is missing; restore it, or remove the frame from the data set's list",
        path.display()
    )]
    MissingPicture {
        /// Where it was looked for.
        path: PathBuf,
        /// Name of the frame.
        frame: String,
    },
    /// A picture cannot be decoded.
    #[error("{image}: picture cannot be decoded, expected a complete PNG or JPEG file")]
    Picture {
        /// The file, or the part of one.
        image: ImageSource,
        /// The decoder's reason.
        #[source]
        source: image::ImageError,
    },
    /// A JPEG file that is cut short or garbled; a decoder would go on with grey or nonsense.
    #[error(
        "{image}: JPEG file is damaged; restore it from a copy, or remove the frame from the data set's list"
    )]
    DamagedJpeg {
        /// The file, or the part of one.
        image: ImageSource,
        /// How that is known.
        #[source]
        source: crate::JpegRule,
    },
    /// A picture that lies partly beyond the end of the file that should hold it.
    #[error(
        "{}: a picture of {length} bytes is to begin at byte {offset}, but the file has only {held} bytes",
        path.display()
    )]
    OutsideFile {
        /// The file.
        path: PathBuf,
        /// Where the picture should begin, bytes.
        offset: u64,
        /// Its length, bytes.
        length: u64,
        /// Length of the file, bytes.
        held: u64,
    },
    /// A picture, stored or asked for, with more pixels than a view may have.
    #[error("{what} is {width}x{height}, expected at least one and at most {max_pixels} pixels")]
    TooLarge {
        /// The file, or `target size`.
        what: String,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// The limit.
        max_pixels: usize,
    },
    /// A picture whose shape is not the one the intrinsics are given for.
    #[error(
        "{}: picture is {width}x{height}, but the intrinsics are for {stated_width}x{stated_height}: \
         the aspect ratios differ by more than 1 % (cropped or rotated?)",
        path.display()
    )]
    Aspect {
        /// The picture.
        path: PathBuf,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// Width that the intrinsics are for.
        stated_width: usize,
        /// Height that the intrinsics are for.
        stated_height: usize,
    },
    /// An EXR file that cannot be decoded.
    #[error("{}: cannot be decoded, expected a complete EXR file", path.display())]
    Exr {
        /// The file.
        path: PathBuf,
        /// The decoder's reason.
        #[source]
        source: exr::error::Error,
    },
    /// A file that is too short for the picture that its header announces.
    #[error("{}: {bytes} bytes cannot hold the {width}x{height} pixels that the header announces", path.display())]
    Unlikely {
        /// The file.
        path: PathBuf,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Length of the file.
        bytes: usize,
    },
    /// A depth file that holds something else.
    #[error(
        "{}: depth is {found}, expected a 16-bit greyscale PNG or one EXR channel of floats (0 = no measurement)",
        path.display()
    )]
    DepthFormat {
        /// The file.
        path: PathBuf,
        /// What it holds.
        found: String,
    },
    /// The lens model maps two directions to one pixel inside the picture.
    #[error(
        "{}: lens distortion folds at pixel ({x}, {y}): its coefficients do not describe this picture; \
         calibrate again, or undistort the pictures and set the coefficients to 0",
        path.display()
    )]
    LensFolds {
        /// The picture.
        path: PathBuf,
        /// Column of an undistorted pixel where it folds.
        x: usize,
        /// Its row.
        y: usize,
    },
    /// A picture that spans half of all directions or more, or whose lens folds before its border.
    #[error(
        "{}: lens sees 180 degrees or more, or folds before the border of the picture: no pinhole picture shows that; \
         crop the pictures, or undistort them first",
        path.display()
    )]
    LensTooWide {
        /// The picture.
        path: PathBuf,
    },
    /// Undistorting leaves no pixel that the picture covers.
    #[error("{}: lens distortion leaves no part of the picture to show", path.display())]
    LensEmpty {
        /// The picture.
        path: PathBuf,
    },
    /// Views that go together have different sizes.
    #[error(
        "views have different sizes: {first} is {first_width}x{first_height}, {second} is \
         {second_width}x{second_height}; ask for one size, to which all are scaled and cropped"
    )]
    MixedSizes {
        /// Name of the first view.
        first: String,
        /// Its width.
        first_width: usize,
        /// Its height.
        first_height: usize,
        /// Name of the first view that differs.
        second: String,
        /// Its width.
        second_width: usize,
        /// Its height.
        second_height: usize,
    },
    /// A view does not pass the checks of `gs-scene`.
    #[error("frame {frame} makes no valid view")]
    View {
        /// Name of the frame.
        frame: String,
        /// The rule.
        #[source]
        source: gs_scene::Error,
    },
    /// An evaluation index breaks a rule of its format.
    #[error("{}: {}: {rule}", path.display(), if key.is_empty() { "index" } else { key })]
    Index {
        /// The file.
        path: PathBuf,
        /// The entry, `scene/window`; empty if the rule concerns the whole file.
        key: String,
        /// The rule, with expected and found.
        rule: crate::IndexRule,
    },
    /// A selection of no views.
    #[error("0 views asked for, expected at least 1")]
    NoViews,
    /// More views asked for than there are frames.
    #[error("{wanted} views asked for, but there are only {frames} frames; ask for fewer")]
    TooFewFrames {
        /// Views asked for.
        wanted: usize,
        /// Frames there are.
        frames: usize,
    },
    /// Too few frames see the same part of the scene.
    #[error(
        "{wanted} views asked for, but at most {connected} frames are connected (each shares half of its content \
         with another); {}take photographs with more overlap",
        if *connected < 2 { String::new() } else { format!("ask for at most {connected}, or ") }
    )]
    Disconnected {
        /// Views asked for.
        wanted: usize,
        /// Size of the largest connected set.
        connected: usize,
    },
    /// A depth range that is none.
    #[error(
        "scene depth is near {near}, median {median}, far {far}; expected 0 < near <= median <= far < infinity"
    )]
    SceneDepth {
        /// Nearest depth.
        near: f64,
        /// Median depth.
        median: f64,
        /// Farthest depth.
        far: f64,
    },
}

/// A handful of names; a chunk may hold hundreds.
fn scenes(names: &[String], dropped: &[Dropped]) -> String {
    const SHOWN: usize = 8;
    let mut text = format!("{}", names.len());
    for (i, name) in names.iter().take(SHOWN).enumerate() {
        text += if i == 0 { ": " } else { ", " };
        text += name;
    }
    if names.len() > SHOWN {
        text += ", ...";
    }
    if let Some(first) = dropped.first() {
        text += &format!("; {} cannot be read, the first is {}: {}", dropped.len(), first.key, first.reason);
    }
    text
}

fn prefix(place: &str) -> String {
    if place.is_empty() { String::new() } else { format!("{place}: ") }
}

fn place(frame: Option<&str>) -> String {
    frame.map_or_else(String::new, |frame| format!("frame {frame}: "))
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;

impl From<tensor_files::TorchError> for Error {
    fn from(error: tensor_files::TorchError) -> Self {
        match error {
            tensor_files::TorchError::Read { path, source } => Self::Read { path, source },
            tensor_files::TorchError::Torch { path, rule } => Self::Torch { path, rule },
        }
    }
}
