//! Turns the light of the samples into the picture.

use super::RayCounts;
use crate::Rgb;
use crate::texture::encode;
use glam::Vec3;

/// What records the light.
pub(super) trait Film: Sync {
    /// What is recorded of the light of one sample, 0..1. Clipped per sample: a bright surface behind an edge must
    /// not outshine it (the display cannot show it).
    fn expose(&self, light: Vec3) -> Vec3;
    /// The picture's value at a pixel from the mean of what its samples left, sRGB-encoded.
    fn develop(&self, x: usize, y: usize, mean: Vec3, counts: &mut RayCounts) -> Rgb;
}

/// Shows display white as 1, without noise.
pub(super) struct Plain;

impl Film for Plain {
    fn expose(&self, light: Vec3) -> Vec3 {
        light.min(Vec3::ONE)
    }

    fn develop(&self, _: usize, _: usize, mean: Vec3, _: &mut RayCounts) -> Rgb {
        encode(mean)
    }
}
