//! The lights of a scene, ready for shading: linear units, unit directions.

use crate::texture::linear;
use crate::{Sky, Sun};
use glam::{DVec3, Vec3};

/// Parallel light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SunLight {
    /// Towards the sun, unit length.
    pub(crate) direction: DVec3,
    /// What a white surface that faces the sun reflects.
    pub(crate) radiance: Vec3,
}

/// The background and its light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SkyLight {
    zenith: Vec3,
    horizon: Vec3,
    ground: Vec3,
    light: f32,
}

impl SunLight {
    /// `None` for a sun that sheds no light.
    pub(crate) fn new(sun: &Sun) -> Option<Self> {
        let radiance = linear(sun.colour) * sun.strength;
        (radiance.max_element() > 0.0).then(|| Self { direction: sun.towards.normalize(), radiance })
    }
}

impl SkyLight {
    pub(crate) fn new(sky: &Sky) -> Self {
        let Sky { zenith, horizon, ground, light, .. } = *sky;
        Self { zenith: linear(zenith), horizon: linear(horizon), ground: linear(ground), light }
    }

    /// The background in a direction of any length.
    pub(crate) fn background(&self, direction: DVec3) -> Vec3 {
        let up = direction.z / direction.length();
        if up < 0.0 { self.ground } else { self.horizon.lerp(self.zenith, up.sqrt() as f32) }
    }

    /// What a white surface with this normal reflects of the light from all sides.
    pub(crate) fn ambient(&self, normal: DVec3) -> Vec3 {
        let above = (self.zenith + self.horizon) * 0.5;
        self.ground.lerp(above, (0.5 + 0.5 * normal.z) as f32) * self.light
    }
}
