//! Counts of the rays and draws of a picture, by kind.

use serde::Serialize;
use std::ops::Add;

/// What a picture took, by kind: rays first, then what else is done per sample, pixel or row. What a scene and its
/// photographs do not call for is 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct RayCounts {
    /// Rays from the camera for the colour: one per sample.
    pub primary: u64,
    /// Rays from the camera for the depth: one per pixel.
    pub depth: u64,
    /// Rays from a lit surface towards the sun.
    pub shadow: u64,
    /// Rays from a lit surface towards a lamp.
    pub lamp_shadow: u64,
    /// Short rays that find what keeps the light from all sides off.
    pub occlusion: u64,
    /// Rays thrown back by a mirror.
    pub mirror: u64,
    /// Rays thrown back by glass.
    pub reflection: u64,
    /// Rays that pass a surface of glass, bent or straight.
    pub refraction: u64,
    /// Directions computed through the distortion of the lens.
    pub distorted: u64,
    /// Places drawn on the opening of the lens.
    pub lens_points: u64,
    /// Moments drawn while the shutter is open.
    pub moments: u64,
    /// Rows with a pose of their own.
    pub row_poses: u64,
    /// Pixels with a gain of exposure and white balance.
    pub gains: u64,
    /// Random numbers for the noise of the sensor.
    pub noise: u64,
}

impl Add for RayCounts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            primary: self.primary + other.primary,
            depth: self.depth + other.depth,
            shadow: self.shadow + other.shadow,
            lamp_shadow: self.lamp_shadow + other.lamp_shadow,
            occlusion: self.occlusion + other.occlusion,
            mirror: self.mirror + other.mirror,
            reflection: self.reflection + other.reflection,
            refraction: self.refraction + other.refraction,
            distorted: self.distorted + other.distorted,
            lens_points: self.lens_points + other.lens_points,
            moments: self.moments + other.moments,
            row_poses: self.row_poses + other.row_poses,
            gains: self.gains + other.gains,
            noise: self.noise + other.noise,
        }
    }
}

impl RayCounts {
    /// Rays of every kind.
    #[must_use]
    pub fn rays(&self) -> u64 {
        let secondary = self.shadow + self.lamp_shadow + self.occlusion;
        self.primary + self.depth + secondary + self.mirror + self.reflection + self.refraction
    }
}
