//! The report of a check, as data: keys are stable, lengths are in scene units, angles in degrees, times in
//! seconds.

use serde::Serialize;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Looked at and right.
    Ok,
    /// Worth knowing; nothing has to be done.
    Note,
    /// Results will be worse than they need to be, or something could not be checked.
    Warning,
    /// Results will be wrong, or a frame cannot be read.
    Error,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// How much it matters.
    pub severity: Severity,
    /// The file, the frame, or the part of the data set.
    pub place: String,
    /// Stable name of the rule, for scripts.
    pub rule: &'static str,
    /// What was found and what to do about it.
    pub text: String,
}

/// Everything that [`check_data`](crate::check_data) found.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CheckReport {
    /// Name of the data set.
    pub name: String,
    /// The file that lists the frames.
    pub file: String,
    /// The layout.
    pub format: String,
    /// Frames listed.
    pub frames: usize,
    /// The picture files.
    pub pictures: PictureSummary,
    /// The lenses.
    pub lens: LensSummary,
    /// The measured depth, if there is any.
    pub depth_files: Option<DepthFileSummary>,
    /// Frames with a mask; masks are recorded, not applied.
    pub masks: usize,
    /// Whether the poses fit the pictures.
    pub poses: PoseSummary,
    /// Whether the measured depth fits the poses.
    pub depth: Option<DepthSummary>,
    /// How far away the scene is; `None` if nothing tells.
    pub range: Option<RangeSummary>,
    /// Where the cameras are.
    pub layout: LayoutSummary,
    /// Which frames see the same; `None` if nothing tells how far the scene is, or there are too many frames.
    pub overlap: Option<OverlapSummary>,
    /// Every frame, in the order of the data set.
    pub cameras: Vec<CameraSummary>,
    /// A sample of the data set's points, or of matches that were triangulated: x, y, z.
    pub points: Vec<[f64; 3]>,
    /// What all this means, the worst first.
    pub findings: Vec<Finding>,
    /// Small pictures of some frames, for the page.
    #[serde(skip)]
    pub thumbnails: Vec<Thumbnail>,
}

impl CheckReport {
    /// The worst severity of all findings.
    #[must_use]
    pub fn worst(&self) -> Severity {
        self.findings.iter().map(|finding| finding.severity).max().unwrap_or(Severity::Ok)
    }

    /// How many findings have a severity.
    #[must_use]
    pub fn count(&self, severity: Severity) -> usize {
        self.findings.iter().filter(|finding| finding.severity == severity).count()
    }
}

/// The picture files of a data set.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PictureSummary {
    /// Read and decoded without fault.
    pub decoded: usize,
    /// Not there.
    pub missing: usize,
    /// There, but not decodable, or of a shape that does not fit the intrinsics.
    pub broken: usize,
    /// Sizes, the commonest first.
    pub sizes: Vec<SizeCount>,
    /// Mean brightness (luma, 0..1): least, median, greatest.
    pub brightness: Option<[f64; 3]>,
    /// Variance of the Laplacian, grey levels squared: least, median, greatest.
    pub sharpness: Option<[f64; 3]>,
}

/// How many pictures have a size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct SizeCount {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pictures.
    pub frames: usize,
}

/// The lenses of a data set, at the size that the intrinsics are stated for.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct LensSummary {
    /// Horizontal field of view of the pinhole, degrees: least and greatest.
    pub field_of_view: [f64; 2],
    /// Horizontal focal length over width: least and greatest.
    pub focal_over_width: [f64; 2],
    /// Greatest ratio of fy to fx or fx to fy.
    pub focal_ratio: f64,
    /// Greatest distance of the principal point from the picture's centre, as a share of the width or height.
    pub off_centre: f64,
    /// Frames whose lens is no pinhole.
    pub distorted: usize,
    /// The farthest that distortion moves what a corner or an edge's middle of a picture shows, pixels.
    pub distortion_pixels: f64,
    /// Different intrinsics in the set.
    pub different: usize,
}

/// The files of measured depth.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct DepthFileSummary {
    /// Frames that have one.
    pub frames: usize,
    /// Read without fault.
    pub decoded: usize,
    /// Scene units per count: least and greatest.
    pub unit: [f64; 2],
    /// Share of pixels with a measurement, 0..1: median over the frames.
    pub coverage: f64,
}

/// How the files' poses may be misread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Reading {
    /// The poses and intrinsics as the reader has them.
    AsRead,
    /// The camera axes are OpenGL's where they were taken for OpenCV's, or the other way about.
    OtherAxes,
    /// The matrix is world-to-camera where it was taken for camera-to-world, or the other way about.
    Inverse,
    /// Both.
    InverseOtherAxes,
    /// The y axis of camera and world points the other way.
    YFlipped,
    /// The pictures stand on their heads.
    UpsideDown,
    /// The rotation is transposed, the camera centre is right.
    RotationTransposed,
    /// The translation of a world-to-camera pose was taken for the camera centre.
    TranslationAsCentre,
    /// The camera centre has the wrong sign.
    CentreNegated,
    /// Every picture has the pose of the frame after it.
    PoseOfNext,
    /// Every picture has the pose of the frame before it.
    PoseOfPrevious,
    /// The intrinsics are for pictures of half the size.
    HalfSize,
    /// The intrinsics are for pictures of twice the size.
    DoubleSize,
}

/// How well a reading of the poses fits the matches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadingScore {
    /// The reading.
    pub reading: Reading,
    /// Median of the symmetric epipolar distance, pixels of the matched pictures; `None` without matches.
    pub median: Option<f64>,
    /// 90 % are nearer.
    pub p90: Option<f64>,
    /// Share of the matches with a usable angle that lie in front of both cameras, 0..1.
    pub in_front: Option<f64>,
}

/// Matches between pictures against the poses.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PoseSummary {
    /// Pairs of pictures that were matched.
    pub pairs_tried: usize,
    /// Pairs with enough matches.
    pub pairs: usize,
    /// Frames in such pairs.
    pub frames: usize,
    /// Matches, outliers removed without use of the poses.
    pub matches: usize,
    /// Greatest number of picture pixels per pixel of the matched pictures; large pictures are matched
    /// reduced.
    pub reduction: usize,
    /// Every reading; the first is the one as read.
    pub readings: Vec<ReadingScore>,
    /// Factor on the focal length that fits best, and the median with it, where another than 1 fits clearly
    /// better.
    pub focal_factor: Option<[f64; 2]>,
    /// Names of frames whose pictures do not fit their poses while most do.
    pub misfits: Vec<String>,
    /// Pairs of frames that do not fit each other, of which it is not known which of the two is wrong.
    pub unsure: Vec<[String; 2]>,
}

/// Measured depth against poses and matches.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct DepthSummary {
    /// Pairs of frames whose depth was warped into each other.
    pub pairs: usize,
    /// Share of the warped pixels whose depths agree within 2 %, 0..1.
    pub consistent: Option<f64>,
    /// Median of the relative difference of warped depths.
    pub median_difference: Option<f64>,
    /// Matches that have both a measured and a triangulated depth.
    pub matches: usize,
    /// Median of measured over triangulated depth.
    pub ratio: Option<f64>,
    /// Median relative deviation from that ratio, if depth is along the axis (z-depth).
    pub spread_z: Option<f64>,
    /// The same if depth is along the ray.
    pub spread_ray: Option<f64>,
}

/// Where depths come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum RangeSource {
    /// Measured depth.
    Measured,
    /// The data set's points.
    Points,
    /// The file's own statement.
    Stated,
    /// Matches, triangulated under the poses as read.
    Matches,
    /// The poses alone: a guess.
    Poses,
}

/// How far away the scene is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RangeSummary {
    /// Where it is known from.
    pub source: RangeSource,
    /// z-depths: 0.5, 2, 50, 98 and 99.5 %, scene units.
    pub percentiles: [f64; 5],
    /// Suggested NEAR and FAR.
    pub near_far: [f64; 2],
}

/// Where the cameras are.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct LayoutSummary {
    /// Median of the camera centres, by axis.
    pub centre: [f64; 3],
    /// Median distance from it.
    pub spread: f64,
    /// Greatest distance from it.
    pub reach: f64,
    /// Median distance to the nearest other camera.
    pub step: f64,
    /// Frames more than 10 median distances away.
    pub outliers: Vec<String>,
}

/// Which frames see the same part of the scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct OverlapSummary {
    /// Sizes of the groups of frames that hang together, the largest first.
    pub components: Vec<usize>,
    /// Pairs of frames that share at least half of their content, both ways: positions in the list.
    pub edges: Vec<[usize; 2]>,
    /// Median, over the frames, of the number of such partners.
    pub partners: f64,
}

/// One frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraSummary {
    /// Its name.
    pub name: String,
    /// Camera centre.
    pub position: [f64; 3],
    /// The camera's x (right), y (down) and z (forward) axes in the world.
    pub axes: [[f64; 3]; 3],
    /// Tangents of half the horizontal and vertical field of view.
    pub half_field: [f64; 2],
    /// Mean brightness of the picture, 0..1.
    pub brightness: Option<f64>,
    /// Variance of the picture's Laplacian, grey levels squared.
    pub sharpness: Option<f64>,
    /// Median epipolar distance of its matches under the poses as read, pixels.
    pub epipolar: Option<f64>,
    /// Its matches.
    pub matches: usize,
    /// The largest share of its content that one other frame sees, 0..1.
    pub shared: Option<f64>,
    /// The group of frames that it belongs to: 0 is the largest.
    pub component: Option<usize>,
}

/// A small picture of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Thumbnail {
    /// Position of the frame.
    pub frame: usize,
    /// JPEG file.
    pub jpeg: Vec<u8>,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}
