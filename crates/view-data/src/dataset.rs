//! A data set as every reader delivers it: where the files are, and how they were taken.

use crate::camera_row::RowCamera;
use crate::points::PointSource;
use crate::{Error, Lens, PoseRule, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use gs_scene::{Camera, Intrinsics};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The frames of a data set and where their files are; the pictures themselves are read by
/// [`Dataset::load_views`].
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Name of the folder.
    pub name: String,
    /// The file that lists the frames.
    pub file: PathBuf,
    /// The folder that holds it.
    pub root: PathBuf,
    /// The layout that it was read from.
    pub format: Format,
    /// Where the pictures come from, if the layout says so (an URL; chunks and RealEstate10K).
    pub url: Option<String>,
    /// The frames in the order of capture as the layout defines it (see the table in the crate's description): an
    /// evaluation index counts positions in it. A frame whose picture is not there keeps its position.
    pub frames: Vec<Frame>,
    /// What the files list and the data set does not use, and why: frames without a picture or a pose, pictures
    /// without a frame, files that are passed over.
    pub dropped: Vec<Dropped>,
    /// Depths of the scene as the file states them (key `scene_depth_percentiles`).
    pub depth_percentiles: Option<DepthPercentiles>,
    /// The transform from the original (COLMAP) world to the world of the poses, where the file records one
    /// (`applied_transform`). The poses contain it already; it is kept so that a result can say its frame.
    pub applied_transform: Option<DAffine3>,
    /// The scale that the poses contain beside it (`applied_scale`).
    pub applied_scale: Option<f64>,
    /// What was subtracted from all positions, cameras and points alike, where the scene lies far from the origin of its world: adding
    /// it gives the positions of the files. Set by [`open`](crate::open) and [`open_all`](crate::open_all) alone.
    pub offset: Option<DVec3>,
    /// Where the points of the scene are, if the layout has some; [`Dataset::points`] reads them.
    pub(crate) points: Option<PointSource>,
}

/// A layout of files that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Format {
    /// `transforms.json` of nerfstudio, instant-ngp or Blender exports.
    Nerfstudio,
    /// A sparse model of COLMAP, text or binary.
    Colmap,
    /// Replica as rendered for NICE-SLAM: `traj.txt` and `results/`.
    Replica,
    /// TUM RGB-D: `rgb.txt`, `depth.txt`, `groundtruth.txt`.
    Tum,
    /// ScanNet as exported frame by frame: `color/`, `depth/`, `pose/`, `intrinsic/`.
    ScanNet,
    /// pixelSplat's `.torch` chunks.
    Chunk,
    /// The folders of DL3DV.
    Dl3dv,
    /// RealEstate10K's camera text with extracted frames.
    Re10k,
}

impl Format {
    /// Every format, in the order in which [`open`](crate::open) tries them.
    pub const ALL: [Self; 8] = [
        Self::Nerfstudio,
        Self::Colmap,
        Self::Replica,
        Self::Tum,
        Self::ScanNet,
        Self::Chunk,
        Self::Dl3dv,
        Self::Re10k,
    ];

    /// The name that a user types.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nerfstudio => "nerfstudio",
            Self::Colmap => "colmap",
            Self::Replica => "replica",
            Self::Tum => "tum",
            Self::ScanNet => "scannet",
            Self::Chunk => "chunk",
            Self::Dl3dv => "dl3dv",
            Self::Re10k => "re10k",
        }
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

impl std::str::FromStr for Format {
    type Err = Error;
    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|format| format.name() == name);
        known.ok_or_else(|| Error::UnknownFormat { found: name.to_owned() })
    }
}

/// Something that a file lists and that is not used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dropped {
    /// What it is: name of the frame, key of the entry, or the file.
    pub key: String,
    /// Why, in words.
    pub reason: String,
}

impl Dropped {
    pub(crate) fn new(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }

    /// What could not be read, with the error and its causes.
    pub(crate) fn failed(key: impl Into<String>, error: &Error) -> Self {
        Self::new(key, crate::open::chain(error))
    }

    /// The entry of a frame without picture.
    pub(crate) fn missing_picture(frame: &Frame) -> Self {
        // A folder that may not be looked into hides its files, which then are not missing.
        let reason = match std::fs::metadata(frame.image.path()) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                format!("picture cannot be read: {}: {error}", frame.image)
            }
            _ => format!("picture missing: {}", frame.image),
        };
        Self::new(frame.name.clone(), reason)
    }
}

/// Where the encoded picture (PNG or JPEG) of a frame lies.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ImageSource {
    /// A file of its own.
    File(PathBuf),
    /// A range of bytes of a file that holds several pictures; read when the picture is.
    Encoded {
        /// The file.
        path: PathBuf,
        /// Where the picture begins, bytes.
        offset: u64,
        /// How long it is, bytes.
        length: u64,
    },
    /// The frame is listed, but its picture is not there, or was given up ([`Dataset::give_up`]). Loading it is an error.
    Missing(PathBuf),
}

impl ImageSource {
    /// The file, or where it was looked for.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) | Self::Encoded { path, .. } | Self::Missing(path) => path,
        }
    }

    /// Whether the picture was not there when the data set was opened, or was given up since.
    #[must_use]
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Missing(_))
    }
}

/// The file, and for one of several pictures in it the first byte.
impl std::fmt::Display for ImageSource {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::File(path) | Self::Missing(path) => path.display().fmt(formatter),
            Self::Encoded { path, offset, .. } => write!(formatter, "{} at byte {offset}", path.display()),
        }
    }
}

/// One posed photograph of a data set, not yet read.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Stem of the picture's file name; where two frames share it, the whole relative path with `_` for `/`.
    pub name: String,
    /// When it was taken, seconds on the data set's own clock, where that is known.
    pub time: Option<f64>,
    /// The picture, PNG or JPEG.
    pub image: ImageSource,
    /// Measured z-depth, where there is one.
    pub depth: Option<DepthFile>,
    /// A mask, where there is one (black = ignore). It is recorded, not applied.
    pub mask_path: Option<PathBuf>,
    /// Intrinsics and distortion, for the stated picture size.
    pub lens: Lens,
    /// The camera's x (right), y (down) and z (forward) axis in the world, as columns.
    pub axes: DMat3,
    /// The camera centre in the world, scene units.
    pub position: DVec3,
}

/// A file of measured z-depth: 16-bit greyscale PNG, or EXR with 16- or 32-bit floats. 0, and in EXR what is not
/// finite or below 0, is no measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFile {
    /// The file.
    pub path: PathBuf,
    /// Scene units per count of the file.
    pub unit: f64,
    /// Greatest count that is a measurement; a sensor's "too far" may lie above it.
    pub max_count: f64,
    /// The pinhole of the depth picture, where it is stated apart: same place and axes as the frame, its own pixels.
    /// Without, depth covers what the frame's picture covers.
    pub intrinsics: Option<Intrinsics>,
}

impl DepthFile {
    /// Depth that covers what its picture covers, every count above 0 a measurement.
    #[must_use]
    pub fn new(path: PathBuf, unit: f64) -> Self {
        Self { path, unit, max_count: f64::INFINITY, intrinsics: None }
    }
}

/// Camera depths of the scene's points, scene units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPercentiles {
    /// 0.5 % of the points are nearer.
    pub p0_5: f64,
    /// 2 % are nearer.
    pub p2: f64,
    /// Half of them are nearer.
    pub p50: f64,
    /// 98 % are nearer.
    pub p98: f64,
    /// 99.5 % are nearer.
    pub p99_5: f64,
}

impl Frame {
    /// A frame whose camera is a row of RealEstate10K.
    pub(crate) fn of_row(name: String, image: ImageSource, camera: RowCamera) -> Self {
        let RowCamera { lens, axes, position } = camera;
        Self { name, time: None, image, depth: None, mask_path: None, lens, axes, position }
    }

    /// The frame's camera at the stated picture size, its distortion left out: where the frame looks, before any
    /// picture is read. The exact camera of the pixels comes with [`Dataset::load_views`].
    ///
    /// # Errors
    /// If the numbers make no camera; those of a frame from a reader do.
    pub fn camera(&self) -> gs_scene::Result<Camera> {
        Camera::from_camera_to_world(self.lens.intrinsics, self.axes, self.position)
    }
}

impl Dataset {
    /// A data set of which nothing but the frames is known.
    pub(crate) fn new(
        format: Format,
        name: String,
        file: PathBuf,
        root: PathBuf,
        frames: Vec<Frame>,
    ) -> Self {
        Self {
            name,
            file,
            root,
            format,
            url: None,
            frames,
            dropped: Vec::new(),
            depth_percentiles: None,
            applied_transform: None,
            offset: None,
            applied_scale: None,
            points: None,
        }
    }

    /// [`Frame::camera`] of every frame.
    ///
    /// # Errors
    /// If the numbers of a frame make no camera.
    pub fn cameras(&self) -> Result<Vec<Camera>> {
        (0..self.frames.len()).map(|position| self.camera(position)).collect()
    }

    /// [`Frame::camera`] of the frame at a position.
    ///
    /// # Errors
    /// If there is none, or its numbers make no camera.
    pub fn camera(&self, position: usize) -> Result<Camera> {
        let frame = self.frame(position)?;
        frame.camera().map_err(|source| Error::View { frame: frame.name.clone(), source })
    }

    /// The files that the data set is read from, as far as they are there: lists, cameras, pictures, depth, masks and points.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        let mut files = vec![self.file.clone()];
        for frame in &self.frames {
            files.push(frame.image.path().to_path_buf());
            files.extend(frame.depth.iter().map(|depth| depth.path.clone()));
            files.extend(frame.mask_path.clone());
        }
        if let Some(PointSource::Ply(path)) = &self.points {
            files.push(path.clone());
        }
        // What lies beside the list, or in the folder of the scene, and is read with it.
        let beside = self.file.parent().unwrap_or(Path::new(""));
        for folder in [beside, &self.root] {
            files.extend(COMPANIONS.iter().map(|name| folder.join(name)));
        }
        files.extend(self.root.parent().map(|above| above.join("cam_params.json")));
        files.retain(|file| file.is_file());
        files.sort_unstable();
        files.dedup();
        files
    }

    /// Positions of the frames whose pictures are there, increasing.
    #[must_use]
    pub fn present(&self) -> Vec<usize> {
        (0..self.frames.len()).filter(|&position| !self.frames[position].image.is_missing()).collect()
    }

    /// The data set without the picture that loading failed on, as if it were missing; `None` if `error` is about something else. The error
    /// and its causes become the reason in [`Dataset::dropped`].
    #[must_use]
    pub fn give_up(&self, error: &Error) -> Option<Self> {
        let (Error::Picture { image, .. } | Error::DamagedJpeg { image, .. }) = error else { return None };
        let mut rest = self.clone();
        let frame = rest.frames.iter_mut().find(|frame| frame.image == *image)?;
        frame.image = ImageSource::Missing(image.path().to_path_buf());
        rest.dropped.push(Dropped::failed(frame.name.clone(), error));
        Some(rest)
    }

    /// The frame at a position.
    ///
    /// # Errors
    /// If there is none.
    pub fn frame(&self, position: usize) -> Result<&Frame> {
        self.frames.get(position).ok_or_else(|| Error::Position {
            name: self.name.clone(),
            position,
            frames: self.frames.len(),
        })
    }
}

/// Names of the files that some layout reads beside the list of its frames.
const COMPANIONS: [&str; 16] = [
    "transforms.json",
    "evaluation_index.json",
    "index.json",
    "cam_params.json",
    "cameras.bin",
    "cameras.txt",
    "images.bin",
    "images.txt",
    "points3D.bin",
    "points3D.txt",
    "rgb.txt",
    "depth.txt",
    "groundtruth.txt",
    "camera.txt",
    "calibration.txt",
    "traj.txt",
];

/// The rotation nearest to a matrix that is one up to a uniform positive scale and rounded digits: the polar factor,
/// by Newton's iteration X ← (X + X⁻ᵀ) / 2.
///
/// The scale is taken out because no pixel depends on it (a scaled camera object in Blender writes one).
pub(crate) fn nearest_rotation(matrix: DMat3) -> std::result::Result<DMat3, PoseRule> {
    let determinant = matrix.determinant();
    if determinant < 0.0 {
        return Err(PoseRule::Mirrored);
    }
    let mut rotation = matrix * determinant.cbrt().recip();
    let gram = rotation * rotation.transpose() - DMat3::IDENTITY;
    let deviation = gram.to_cols_array().into_iter().fold(0.0, |worst: f64, entry| worst.max(entry.abs()));
    // A zero matrix gives NaN, which `max` passes over.
    if deviation > ROUNDED_ROTATION || !rotation.is_finite() {
        return Err(PoseRule::NotARotation { deviation });
    }
    // Convergence is quadratic: 1e-2, 1e-4, 1e-8, 1e-16.
    for _ in 0..5 {
        rotation = (rotation + rotation.inverse().transpose()) * 0.5;
    }
    Ok(rotation)
}

/// A rotation from a quaternion (w, x, y, z) of any length but 0.
pub(crate) fn unit_quaternion([w, x, y, z]: [f64; 4]) -> std::result::Result<DQuat, PoseRule> {
    let quaternion = DQuat::from_xyzw(x, y, z, w);
    // Scaled first, so that squares neither vanish nor overflow.
    let largest = w.abs().max(x.abs()).max(y.abs()).max(z.abs());
    if !quaternion.is_finite() || largest == 0.0 {
        return Err(PoseRule::Quaternion { found: [w, x, y, z] });
    }
    let scaled = if largest.is_normal() { quaternion / largest } else { quaternion * f64::MAX };
    Ok(scaled.normalize())
}

/// Largest entry of `R Rᵀ - I` that is taken for rounded digits (three decimals give a few 1e-3).
const ROUNDED_ROTATION: f64 = 1e-2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_and_scaled_rotations_are_mended_and_others_refused() {
        let exact = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0);
        let rounded = DMat3::from_cols_array(&exact.to_cols_array().map(|v| (v * 1e3).round() / 1e3));
        for input in [exact, rounded, rounded * 2.5, exact * 1e-3] {
            let mended = nearest_rotation(input).unwrap();
            let gram = mended * mended.transpose() - DMat3::IDENTITY;
            assert!(gram.to_cols_array().iter().all(|entry| entry.abs() < 1e-14));
            assert!((mended - exact).to_cols_array().iter().all(|entry| entry.abs() < 1e-3));
        }
        let sheared = exact * DMat3::from_diagonal(DVec3::new(1.1, 1.0, 1.0));
        for broken in [sheared, DMat3::ZERO, DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)), exact * 1e200] {
            assert!(matches!(nearest_rotation(broken), Err(PoseRule::NotARotation { .. })), "{broken}");
        }
        assert!(matches!(nearest_rotation(-exact), Err(PoseRule::Mirrored)));
    }
}
