use super::PoseRule;

/// Where in a file a rule is broken.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// A line, counted from 1.
    Line(usize),
    /// A position in bytes, counted from 0.
    Byte(u64),
}

impl std::fmt::Display for Place {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Whole => Ok(()),
            Self::Line(line) => write!(formatter, "line {line}: "),
            Self::Byte(byte) => write!(formatter, "byte {byte}: "),
        }
    }
}

/// The rules of text and binary files that can be broken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatRule {
    /// The file ends before what it announces.
    #[error("file ends early: {what} takes {wanted} bytes, {held} are left")]
    Cut {
        /// What was being read.
        what: &'static str,
        /// Bytes it takes.
        wanted: u64,
        /// Bytes there are.
        held: u64,
    },
    /// A count that the rest of the file has no room for.
    #[error("{found} {what} announced, but the rest of the file has room for {most} at most")]
    Count {
        /// What is counted.
        what: &'static str,
        /// The count.
        found: u64,
        /// The most that fit.
        most: u64,
    },
    /// Bytes after the last entry.
    #[error("{bytes} bytes follow the last of the announced entries; is the file of another kind?")]
    Trailing {
        /// How many.
        bytes: u64,
    },
    /// A line or name longer than any real one.
    #[error("{what} is longer than {most} bytes")]
    TooLong {
        /// What.
        what: &'static str,
        /// The limit.
        most: usize,
    },
    /// Bytes that are no UTF-8.
    #[error("{what} is not UTF-8 text")]
    NotText {
        /// What.
        what: &'static str,
    },
    /// A line with too few or too many words.
    #[error("{found} words, expected {expected}")]
    Words {
        /// The words in order.
        expected: &'static str,
        /// How many there are.
        found: usize,
    },
    /// A word that is no number, or not finite.
    #[error("{what} is {found:?}, expected {expected}")]
    Number {
        /// Which word.
        what: &'static str,
        /// The word, cut off after some characters.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A number that is NaN or infinite.
    #[error("{what} is {found}, expected a finite number")]
    NotFinite {
        /// Which.
        what: &'static str,
        /// The number.
        found: f64,
    },
    /// A camera model that is not known.
    #[error("camera model {found} is not known")]
    UnknownModel {
        /// Name or number.
        found: String,
    },
    /// A camera model that makes no pinhole picture.
    #[error("camera model {model} cannot be undistorted to a pinhole picture")]
    Panorama {
        /// The model.
        model: &'static str,
    },
    /// A camera with too few or too many parameters.
    #[error("camera model {model} has {expected} parameters, found {found}")]
    Parameters {
        /// The model.
        model: &'static str,
        /// How many it has.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// Distortion coefficients out of their range.
    #[error("coefficients of camera model {model} are out of range: {found:?}")]
    Coefficients {
        /// The model.
        model: &'static str,
        /// The parameters.
        found: Vec<f64>,
    },
    /// Focal lengths, principal point or size make no camera.
    #[error("the camera is not valid: {0}")]
    Camera(gs_scene::Error),
    /// The pose is none.
    #[error("pose {0}")]
    Pose(PoseRule),
    /// The last row of a pose is not 0 0 0 1.
    #[error("last row of the matrix is {found:?}, expected [0, 0, 0, 1]; is the matrix transposed?")]
    LastRow {
        /// The row.
        found: [f64; 4],
    },
    /// The principal point lies outside the picture.
    #[error(
        "principal point is {found:?}, outside of the {width}x{height} picture: intrinsics of another size?"
    )]
    PrincipalPoint {
        /// As stated.
        found: [f64; 2],
        /// Pixels per row of the picture.
        width: usize,
        /// Its rows.
        height: usize,
    },
    /// Intrinsics with skew.
    #[error("skew is {found}, expected 0")]
    Skew {
        /// The entry.
        found: f64,
    },
    /// The file that states the camera is not there.
    #[error("is not there: the camera is not known{hint}")]
    NoIntrinsics {
        /// What to add; begins with a semicolon.
        hint: String,
    },
    /// A frame refers to a camera that is not there.
    #[error("camera {camera} of image {image:?} is not in the list of cameras")]
    NoCamera {
        /// The camera's id.
        camera: u32,
        /// The image's name.
        image: String,
    },
    /// An id or name that occurs twice.
    #[error("{what} {found} occurs twice")]
    Duplicate {
        /// What.
        what: &'static str,
        /// The id or name.
        found: String,
    },
    /// An image name that leads out of the folder of pictures.
    #[error("image name {name:?} is not a path below the folder of pictures")]
    ImageName {
        /// The name.
        name: String,
    },
    /// The header of a PLY file breaks a rule.
    #[error(transparent)]
    Ply(#[from] gs_scene::PlyRule),
    /// A PLY file whose vertices lack a coordinate.
    #[error("vertex has no property {name}")]
    NoProperty {
        /// `x`, `y` or `z`.
        name: &'static str,
    },
    /// A colour that is not from 0 to 255.
    #[error("colour is {found}, expected a number from 0 to 255")]
    Colour {
        /// The number.
        found: f64,
    },
    /// There is nothing to load.
    #[error("has no frames with a pose, expected at least one{}", hint)]
    NoFrames {
        /// What to look at; empty or beginning with a semicolon.
        hint: String,
    },
}
