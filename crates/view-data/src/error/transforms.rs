use super::PoseRule;

/// The rules of a `transforms.json` that can be broken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransformsRule {
    /// A value of the wrong JSON type.
    #[error("{key} is {found}, expected {expected}")]
    Type {
        /// The key.
        key: String,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: &'static str,
    },
    /// A key that has to be there is absent.
    #[error("key {key} is missing")]
    MissingKey {
        /// The key.
        key: &'static str,
    },
    /// A number is NaN or infinite.
    #[error("{key} is not finite")]
    NotFinite {
        /// The key.
        key: String,
    },
    /// The list of frames is empty.
    #[error("frames is empty, expected at least one frame")]
    NoFrames,
    /// There is no focal length.
    #[error(
        "no intrinsics: neither fl_x (pixels) nor camera_angle_x (radians) is given, per frame or for the file"
    )]
    NoFocal,
    /// A key is given on some frames only, and not for the whole file.
    #[error("{key} is missing here but given on other frames; give it on every frame or once for the file")]
    PartialKey {
        /// The key.
        key: &'static str,
    },
    /// A picture size that is none.
    #[error("{key} is {found}, expected a whole number of pixels from 1 to {}", crate::nerfstudio::MAX_SIDE)]
    Side {
        /// `w` or `h`.
        key: &'static str,
        /// The value.
        found: f64,
    },
    /// A number outside its range.
    #[error("{key} is {found}, expected {expected}")]
    Range {
        /// The key.
        key: &'static str,
        /// The value.
        found: f64,
        /// The range in words.
        expected: &'static str,
    },
    /// A camera model that is not read.
    #[error("camera_model {found:?} is not supported, expected one of {}", crate::nerfstudio::MODELS.join(", "))]
    Model {
        /// The model.
        found: String,
    },
    /// A distortion coefficient that the camera model does not have.
    #[error("{key} is {found}, but the camera model has no such coefficient; undistort the pictures first")]
    Coefficient {
        /// The key.
        key: &'static str,
        /// The value.
        found: f64,
    },
    /// A pinhole model with distortion.
    #[error(
        "camera_model {model} has no distortion, but a distortion coefficient is not 0; set the model to OPENCV"
    )]
    DistortedPinhole {
        /// The model.
        model: String,
    },
    /// `transform_matrix` is not 4×4 (or 3×4).
    #[error("{key} has {found}, expected 4 rows of 4 numbers")]
    MatrixShape {
        /// The key.
        key: &'static str,
        /// Its shape in words.
        found: String,
    },
    /// The last row of a pose is not 0 0 0 1.
    #[error("last row of {key} is {found:?}, expected [0, 0, 0, 1]; is the matrix transposed?")]
    LastRow {
        /// The key.
        key: &'static str,
        /// The row.
        found: [f64; 4],
    },
    /// The 3×3 part of `transform_matrix` is no rotation.
    #[error("transform_matrix {0}")]
    Pose(PoseRule),
    /// Focal lengths, principal point or size make no camera.
    #[error("the camera is not valid: {0}")]
    Camera(gs_scene::Error),
    /// Two frames name the same picture.
    #[error("same picture as frame {first}")]
    DuplicateFrame {
        /// Position of the earlier frame.
        first: usize,
    },
    /// The picture is not where `file_path` says, and several folders have one of its name.
    #[error("picture is not at file_path, and it is in more than one folder: {}; keep one of them", folders.join(", "))]
    AmbiguousPicture {
        /// The folders.
        folders: Vec<String>,
    },
    /// `scene_depth_percentiles` decrease or are not positive.
    #[error("scene_depth_percentiles are {found:?}, expected increasing numbers above 0")]
    Percentiles {
        /// 0.5, 2, 50, 98 and 99.5 %.
        found: [f64; 5],
    },
}
