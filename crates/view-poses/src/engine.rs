//! What an engine is given, and what it gives back.

use crate::{CameraGroup, Photograph, Result};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Lens};
use std::path::Path;
use view_data::ScenePoint;

/// A way from photographs to poses.
pub trait Engine {
    /// Its name.
    fn name(&self) -> &'static str;

    /// Whether it is worth asking: it is there, as far as is known. One that is not says why when it is asked all the same.
    fn can_be_asked(&self, work: &Path) -> bool {
        let _ = work;
        true
    }

    /// Estimates poses, lenses and points, in any world and scale.
    ///
    /// # Errors
    /// If no two photographs match, or the engine fails. A result that is wrong is no error: the engine does not notice.
    fn estimate(&self, task: &Task<'_>, on_step: &(dyn Fn(Step) + Sync)) -> Result<Solution>;
}

/// What an engine works on.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// The folder of the photographs, by their names; all are upright.
    pub images: &'a Path,
    /// The photographs.
    pub photographs: &'a [Photograph],
    /// Their cameras.
    pub cameras: &'a [CameraGroup],
    /// Whether the photographs are frames of a video, in order.
    pub sequence: bool,
    /// Seed of random draws.
    pub seed: u64,
    /// An empty folder for temporary files.
    pub work: &'a Path,
}

/// First guess of a focal length that EXIF data do not give, long sides of the picture: phones have 0.7 to 0.8, zoom lenses 1 to 3.
const GUESS: f64 = 1.2;

impl Task<'_> {
    /// The first focal length of a camera, pixels.
    pub(crate) fn focal(&self, camera: &CameraGroup) -> f64 {
        camera.focal_pixels.unwrap_or(GUESS * camera.width.max(camera.height) as f64)
    }
}

/// A part of the work that takes time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Step {
    /// Looking at frames of a video; how many so far.
    Frames(usize),
    /// Reading photographs: done, of.
    Read(usize, usize),
    /// Finding features.
    Features,
    /// Matching photographs.
    Match,
    /// Finding poses.
    Poses,
    /// The result is doubtful; the named engine begins.
    Again(&'static str),
    /// Comparing poses with matches that were found without them.
    Check,
    /// Taking the distortion of the lens out of the photographs.
    Undistort,
}

/// What an engine found.
#[derive(Debug, Clone)]
pub struct Solution {
    /// A lens for each camera of the task.
    pub lenses: Vec<Lens>,
    /// A pose for each photograph that has one.
    pub poses: Vec<Option<Pose>>,
    /// Why a photograph has none, where the engine says so.
    pub reasons: Vec<Option<String>>,
    /// Triangulated points; observations name photographs by position.
    pub points: Vec<ScenePoint>,
}

/// Place and direction of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The camera's x (right), y (down) and z (forward) axis in the world, as columns.
    pub axes: DMat3,
    /// The camera centre.
    pub position: DVec3,
}

impl Solution {
    /// How many photographs have a pose.
    #[must_use]
    pub fn registered(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    /// The camera of a photograph that has a pose, if its numbers make one.
    pub(crate) fn camera(&self, photographs: &[Photograph], index: usize) -> Option<(Lens, Camera)> {
        let pose = self.poses[index]?;
        let lens = self.lenses[photographs[index].camera];
        Some((lens, Camera::from_camera_to_world(lens.intrinsics, pose.axes, pose.position).ok()?))
    }

    /// Takes the poses of some photographs away.
    pub(crate) fn leave_out(&mut self, photographs: &[usize], reason: &str) {
        for &index in photographs {
            self.poses[index] = None;
            self.reasons[index] = Some(reason.to_owned());
        }
        for point in &mut self.points {
            point.observations.retain(|seen| self.poses[seen.frame].is_some());
        }
        self.points.retain(|point| point.observations.len() > 1);
    }

    /// Leaves out poses and points that are not finite or make no camera.
    pub(crate) fn without_nonsense(mut self, photographs: &[Photograph]) -> Self {
        for index in 0..self.poses.len() {
            if self.poses[index].is_some() && self.camera(photographs, index).is_none() {
                self.poses[index] = None;
                self.reasons[index] = Some("its camera is not finite".to_owned());
            }
        }
        for point in &mut self.points {
            point.observations.retain(|seen| self.poses[seen.frame].is_some());
        }
        self.points.retain(|point| point.position.is_finite() && point.observations.len() > 1);
        self
    }
}
