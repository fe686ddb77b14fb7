//! Origins and directions of the rays of a picture.

use super::RayCounts;
use super::beam::Beam;
use super::draws::Draws;
use crate::trace::{PathRay, Traced};
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Intrinsics};

/// A camera as the renderer sees it. The parameter of its rays is the z-depth.
pub(super) trait CameraRays: Sync {
    /// The ray of the depth of a pixel.
    fn depth(&self, x: usize, y: usize) -> PathRay;
    /// The beam of a colour sample `within` the pixel, 0..1, for `strata` columns and rows of samples in it.
    fn colour(&self, pixel: [usize; 2], within: DVec2, draws: &Draws, counts: &mut RayCounts) -> Beam;
    /// What the whole picture took, beside what its samples count.
    fn prepared(&self) -> RayCounts {
        RayCounts::default()
    }
}

/// Columns and rows of the grid of samples in a pixel: the one closest to a square that holds exactly `samples`.
pub(super) fn strata(samples: u32) -> [u32; 2] {
    let rows = (1..=samples.isqrt()).rev().find(|rows| samples.is_multiple_of(*rows)).unwrap_or(1);
    [samples / rows, rows]
}

/// A camera's place and axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    /// Relative to the middle of the scene.
    pub(super) origin: DVec3,
    pub(super) to_world: DMat3,
}

impl Pose {
    pub(super) fn new(scene: &Traced, camera: &Camera) -> Self {
        Self { origin: scene.relative(camera.position()), to_world: camera.rotation().transpose() }
    }

    /// Change of a pinhole's direction per sample to the right and per sample downwards.
    pub(super) fn steps(&self, lens: &Intrinsics, strata: [u32; 2]) -> [DVec3; 2] {
        let steps = [self.to_world.x_axis / lens.fx, self.to_world.y_axis / lens.fy];
        std::array::from_fn(|i| steps[i] / f64::from(strata[i]))
    }
}

/// A plain camera.
pub(super) struct Pinhole {
    intrinsics: Intrinsics,
    pose: Pose,
    steps: [DVec3; 2],
}

impl Pinhole {
    pub(super) fn new(scene: &Traced, camera: &Camera, samples: u32) -> Self {
        let (intrinsics, pose) = (*camera.intrinsics(), Pose::new(scene, camera));
        Self { intrinsics, pose, steps: pose.steps(&intrinsics, strata(samples)) }
    }

    fn ray(&self, pixel: DVec2) -> PathRay {
        PathRay { origin: self.pose.origin, direction: self.pose.to_world * self.intrinsics.ray(pixel) }
    }
}

impl CameraRays for Pinhole {
    fn depth(&self, x: usize, y: usize) -> PathRay {
        self.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5))
    }

    fn colour(&self, [x, y]: [usize; 2], within: DVec2, _: &Draws, _: &mut RayCounts) -> Beam {
        let ray = self.ray(DVec2::new(x as f64, y as f64) + within);
        Beam { ray, from: [DVec3::ZERO; 2], towards: self.steps }
    }
}
