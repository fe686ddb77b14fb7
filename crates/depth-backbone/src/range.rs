//! The planes of the sweep.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Near and far end of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthRange {
    /// From the poses and sparse matches between the views.
    Estimate,
    /// From what is known of the scene: z-depths, scene units, that hold nearly all of it.
    Known {
        /// Depth that 0.5 % of the scene is nearer than.
        near: f64,
        /// Depth that 0.5 % of the scene is farther than.
        far: f64,
    },
}

/// What is nearer than the near end of the range by up to this factor is still searched.
const NEAR_MARGIN: f64 = 0.8;
/// Stereo searches up to this times the far end of the range: nothing that it finds is farther.
pub const FAR_MARGIN: f64 = 1.25;

/// Every pixel of every view has a cost per plane: more than this is a mistake that would fill the memory.
const MOST_PLANES: usize = 4096;

/// Planes evenly spaced in inverse depth, from far to near.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Planes {
    farthest: f64,
    step: f64,
    count: usize,
}

impl Planes {
    /// `count` planes that cover the range with its margins.
    pub(crate) fn new(near: f64, far: f64, count: usize) -> Result<Self> {
        if !(near > 0.0 && near < far && far.is_finite()) {
            return Err(Error::Range { near, far });
        }
        if !(2..=MOST_PLANES).contains(&count) {
            return Err(Error::Setting { setting: "planes", found: count as f64, expected: "2 to 4096" });
        }
        Ok(Self::between(1.0 / (far * FAR_MARGIN), 1.0 / (near * NEAR_MARGIN), count))
    }

    /// `count` planes, two or more, between two inverse depths, smaller first.
    pub(crate) fn between(farthest: f64, nearest: f64, count: usize) -> Self {
        assert!(count >= 2 && farthest > 0.0 && farthest < nearest, "planes from {farthest} to {nearest}");
        Self { farthest, step: (nearest - farthest) / (count - 1) as f64, count }
    }

    /// The same range with 1/`factor` as many planes.
    pub(crate) fn thinned(&self, factor: usize) -> Self {
        Self::between(self.farthest, self.inverse_depth_at(1.0), self.count.div_ceil(factor).max(2))
    }

    /// Inverse depth at a part (0 far, 1 near) of the range.
    pub(crate) fn inverse_depth_at(&self, part: f64) -> f64 {
        self.farthest + self.step * (self.count - 1) as f64 * part
    }

    /// Number of planes.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Inverse depth between two planes.
    pub(crate) fn step(&self) -> f32 {
        self.step as f32
    }

    /// Inverse depth of a plane, whole or between two.
    pub(crate) fn inverse_depth(&self, plane: f32) -> f32 {
        (self.farthest + self.step * f64::from(plane)) as f32
    }

    /// Smallest and largest inverse depth.
    pub(crate) fn ends(&self) -> (f32, f32) {
        (self.inverse_depth(0.0), self.inverse_depth((self.count - 1) as f32))
    }

    /// Number of the plane next to an inverse depth; beyond the ends planes are counted on.
    pub(crate) fn next_to(&self, inverse_depth: f32) -> i32 {
        // Ties put surfaces halfway between planes, where the last bit would decide if the boundary lay there.
        const BOUNDARY: f64 = 0.4;
        ((f64::from(inverse_depth) - self.farthest) / self.step + BOUNDARY).floor() as i32
    }

    /// All inverse depths, far to near.
    pub(crate) fn inverse_depths(&self) -> Vec<f64> {
        (0..self.count).map(|plane| self.farthest + self.step * plane as f64).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_cover_the_range_with_margins() {
        let planes = Planes::new(2.0, 8.0, 5).unwrap();
        let w = planes.inverse_depths();
        assert!((w[0] - 0.1).abs() < 1e-7 && (w[4] - 0.625).abs() < 1e-7);
        assert!((w[1] - w[0] - f64::from(planes.step())).abs() < 1e-7);
        for (near, far) in [(0.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY), (1.0, 1.0)] {
            assert!(matches!(Planes::new(near, far, 8), Err(Error::Range { .. })));
        }
        assert!(matches!(Planes::new(1.0, 2.0, 1), Err(Error::Setting { .. })));
    }
}
