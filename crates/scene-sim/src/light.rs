//! Lights: what shines, and what shines from all sides.

use crate::Rgb;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A sun so far away that its light is parallel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// From the scene to the sun; any length but 0.
    pub towards: DVec3,
    /// Colour of its light.
    pub colour: Rgb,
    /// What a white surface that faces the sun reflects of it, as a share of display white.
    pub strength: f32,
    /// Angle under which it is seen, degrees: 0.53 for the real one. With 0 its shadows are hard and cost one ray.
    #[serde(default)]
    pub diameter: f64,
}

/// A lamp: a rectangle that sheds light to its front (its own +z), and is seen as a bright surface from there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lamp {
    /// What errors call it.
    pub name: String,
    /// Its middle in the world, metres.
    pub centre: DVec3,
    /// Turns about the world's x, then y, then z axis, degrees: 180 about x shines straight down.
    #[serde(default)]
    pub rotation: DVec3,
    /// Extent along its own x and y, metres. With 0 by 0 it is a point: hard shadows that cost one ray, and not seen.
    pub size: DVec2,
    /// Colour of its light.
    pub colour: Rgb,
    /// What a white surface 1 m in front of its middle, facing it, reflects of it, as a share of display white (as if all
    /// its light came from the middle).
    pub strength: f32,
}

/// A background that depends on the direction alone, and the light that it sheds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sky {
    /// Colour straight up.
    pub zenith: Rgb,
    /// Colour at the horizon.
    pub horizon: Rgb,
    /// Colour below the horizon.
    pub ground: Rgb,
    /// What surfaces receive from all sides, as a multiple of the background's own brightness: a surface that
    /// looks up gets the mean of zenith and horizon, one that looks down the ground's colour.
    pub light: f32,
    /// How things close by keep the light from all sides off a surface. Without it none is kept off, at no cost.
    #[serde(default)]
    pub occlusion: Option<Occlusion>,
}

/// Ambient occlusion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Occlusion {
    /// What is farther away than this keeps nothing off, metres.
    pub reach: f64,
    /// Rays per colour sample, 1 to 256.
    pub rays: u32,
}
