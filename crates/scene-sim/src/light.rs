//! Lights: the sun, lamps, and the sky.

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
    /// Angle under which it is seen, degrees, 0 to 90: 0.53 for the real one. Its shadows are hard with 0, and soft with
    /// more; both cost one ray per colour sample on a surface that faces it, so soft edges want several samples.
    #[serde(default)]
    pub diameter: f64,
}

/// A lamp: a rectangle that sheds light to its front (its own +z), and is seen as a bright surface from there.
///
/// A white surface shows, in shares of display white, strength x cos a x cos b / d² averaged over the lamp: d metres lie
/// between the two places, at the angle a to the surface's normal and b to the lamp's. The lamp itself is as bright as
/// a Lambert emitter that sheds this light: pi x strength / its area. One ray per colour sample goes to a place on it.
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
    /// Extent along its own x and y, metres. With 0 by 0 it is a point, with one 0 a line: neither is seen. The shadows
    /// of a point are hard.
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
    /// looks up gets the mean of zenith and horizon, one that looks down the ground's colour. Without occlusion this
    /// light passes through walls: give a closed room a `light` of 0 or occlusion, and lamps.
    pub light: f32,
    /// How things close by keep the light from all sides off a surface. Without it none is kept off, at no cost.
    #[serde(default)]
    pub occlusion: Option<Occlusion>,
}

/// Ambient occlusion: the share of rays, spread over the hemisphere by the cosine, that meet something within reach.
/// Glass and lamps keep nothing off. Light that surfaces throw to each other is not simulated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Occlusion {
    /// What is farther away than this keeps nothing off, metres.
    pub reach: f64,
    /// Rays per colour sample, 1 to 256.
    pub rays: u32,
}
