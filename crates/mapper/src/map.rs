//! The map: Gaussians, and what keyframes said of each.

use crate::Result;
use glam::DVec3;
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, sigmoid};

/// Bytes of a Gaussian in the map: 14 stored numbers and 3 that are known of it.
pub const BYTES: usize = size_of::<f32>() * (Gaussians::GEOMETRY + 3) + size_of::<Evidence>();

/// Room for so many Gaussians is taken at once; a larger map grows into its room.
const RESERVED: usize = 1 << 22;

/// What keyframes said of a Gaussian.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Evidence {
    /// Screen mass: its shares in the pixels of keyframes, summed.
    pub(crate) mass: f32,
    /// Keyframes in which it was visible.
    pub(crate) looks: f32,
    /// Keyframes that confirmed it, at most [`HEAVIEST`](crate::fuse::HEAVIEST), less those that contradicted it.
    pub(crate) weight: f32,
}

impl Evidence {
    /// Mean screen mass where it was visible, pixels. The sum would let old places displace new ones, which fewer keyframes have seen.
    pub(crate) fn worth(self) -> f32 {
        self.mass / self.looks.max(1.0)
    }
}

/// Gaussians of SH degree 0 with their evidence, never more than `most`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Map {
    pub(crate) gaussians: Gaussians,
    pub(crate) evidence: Vec<Evidence>,
    pub(crate) most: usize,
}

impl Map {
    pub(crate) fn new(most: usize) -> Result<Self> {
        let room = most.min(RESERVED);
        let gaussians =
            Gaussians::new(0, Vec::with_capacity(room * Gaussians::GEOMETRY), Vec::with_capacity(room * 3))?;
        Ok(Self { gaussians, evidence: Vec::with_capacity(room), most })
    }

    pub(crate) fn len(&self) -> usize {
        self.evidence.len()
    }

    pub(crate) fn bytes(&self) -> usize {
        self.len() * BYTES
    }

    /// Appends what a keyframe made; its screen mass is that of the discs in the keyframe's picture.
    pub(crate) fn append(&mut self, new: &Gaussians, camera: &Camera) {
        assert!(self.len() + new.len() <= self.most, "there is room for what is appended");
        let focal = camera.intrinsics().fx * camera.intrinsics().fy;
        self.evidence.extend(new.geometry().chunks_exact(Gaussians::GEOMETRY).map(|row| {
            let z = camera.to_camera(mean(row)).z;
            let area = f64::from(row[LOG_SCALE.start] + row[LOG_SCALE.start + 1]).exp() * focal / (z * z);
            let mass = std::f64::consts::TAU * area * f64::from(sigmoid(row[OPACITY_LOGIT]));
            Evidence { mass: mass as f32, looks: 1.0, weight: 1.0 }
        }));
        self.gaussians.append(new);
    }

    /// Keeps the Gaussians for which `keep` is true.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.gaussians.retain(|i| keep[i]);
        let mut keep = keep.iter();
        self.evidence.retain(|_| keep.next() == Some(&true));
    }
}

/// Mean of a Gaussian, the row of its geometry.
pub(crate) fn mean(row: &[f32]) -> DVec3 {
    DVec3::from_slice(&[row[MEAN.start], row[MEAN.start + 1], row[MEAN.start + 2]].map(f64::from))
}
