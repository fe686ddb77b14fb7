//! The lights of a scene, ready for shading: linear units, unit directions.

use super::body::turn;
use crate::texture::linear;
use crate::{Lamp, Occlusion, Sky, Sun};
use glam::{DVec2, DVec3, Vec3};
use std::f64::consts::PI;

/// Parallel light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SunLight {
    /// Towards the middle of the sun, unit length.
    pub(crate) direction: DVec3,
    /// What a white surface that faces the sun reflects.
    pub(crate) radiance: Vec3,
    /// Of a sun with a diameter.
    pub(crate) disc: Option<Disc>,
}

/// The disc of a sun at unit distance, by its half axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Disc([DVec3; 2]);

/// A lamp in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LampLight {
    /// In the world.
    centre: DVec3,
    /// Its whole extents along its own x and y; 0 for a point.
    edges: [DVec3; 2],
    /// Into which it shines, unit length.
    pub(crate) front: DVec3,
    /// What a white surface 1 m in front of it, facing it, reflects.
    pub(crate) strength: Vec3,
    /// How bright it is itself.
    pub(crate) seen: Vec3,
}

/// The background and its light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SkyLight {
    zenith: Vec3,
    horizon: Vec3,
    ground: Vec3,
    light: f32,
    /// Only where there is light to be kept off.
    pub(crate) occlusion: Option<Occlusion>,
}

impl SunLight {
    /// `None` for a sun that sheds no light.
    pub(crate) fn new(sun: &Sun) -> Option<Self> {
        let radiance = linear(sun.colour) * sun.strength;
        let direction = sun.towards.normalize();
        let radius = (0.5 * sun.diameter).to_radians().tan();
        let disc = (radius > 0.0).then(|| {
            let (right, up) = direction.any_orthonormal_pair();
            Disc([right * radius, up * radius])
        });
        (radiance.max_element() > 0.0).then_some(Self { direction, radiance, disc })
    }
}

impl Disc {
    /// Towards a place on the disc around `middle`, from two numbers in 0..1; unit length.
    pub(crate) fn towards(&self, middle: DVec3, within: DVec2) -> DVec3 {
        let place = on_disc(within);
        (middle + self.0[0] * place.x + self.0[1] * place.y).normalize()
    }
}

impl LampLight {
    pub(crate) fn new(lamp: &Lamp) -> Self {
        let turned = turn(lamp.rotation);
        let strength = linear(lamp.colour) * lamp.strength;
        let area = lamp.size.x * lamp.size.y;
        // A white surface that receives E shows E / pi; a Lambert lamp of radiance L and area A sends L A / d^2
        // straight ahead. A lamp without area is not seen.
        let seen = if area > 0.0 { (strength.as_dvec3() * (PI / area)).as_vec3() } else { Vec3::ZERO };
        Self {
            centre: lamp.centre,
            edges: [turned.x_axis * lamp.size.x, turned.y_axis * lamp.size.y],
            front: turned.z_axis,
            strength,
            seen: seen.min(Vec3::splat(f32::MAX)),
        }
    }

    /// A place on it in the world, from two numbers in 0..1.
    pub(crate) fn place(&self, within: DVec2) -> DVec3 {
        self.centre + self.edges[0] * (within.x - 0.5) + self.edges[1] * (within.y - 0.5)
    }

    /// Whether all of its light comes from one point.
    pub(crate) fn is_point(&self) -> bool {
        self.edges == [DVec3::ZERO; 2]
    }
}

/// A place in the unit disc, evenly spread if the two numbers in 0..1 are.
pub(crate) fn on_disc(within: DVec2) -> DVec2 {
    DVec2::from_angle(2.0 * PI * within.x) * within.y.sqrt()
}

impl SkyLight {
    pub(crate) fn new(sky: &Sky) -> Self {
        let Sky { zenith, horizon, ground, light, occlusion } = *sky;
        let [zenith, horizon, ground] = [zenith, horizon, ground].map(linear);
        let sheds = light > 0.0 && zenith.max(horizon).max(ground).max_element() > 0.0;
        Self { zenith, horizon, ground, light, occlusion: occlusion.filter(|o| sheds && o.reach > 0.0) }
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
