//! The description of a scene: plain data, which a person can write by hand.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A colour as people pick it: sRGB-encoded red, green and blue in 0..1. Light is computed on the linear
/// values.
pub type Rgb = [f32; 3];

/// Solid things under a sun and a sky. Lengths are metres, angles degrees, and the world's z axis points up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// What stands in the scene; may be empty.
    pub primitives: Vec<Primitive>,
    /// The light that casts shadows. Without it no shadow ray is traced.
    #[serde(default)]
    pub sun: Option<Sun>,
    /// The background, and the light that comes from all sides.
    pub sky: Sky,
}

/// One solid shape with its place and surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Primitive {
    /// What errors call it.
    pub name: String,
    /// Its form, around the origin of its own axes.
    pub shape: Shape,
    /// Where that origin lies in the world, metres.
    pub centre: DVec3,
    /// Turns about the world's x, then y, then z axis, degrees.
    #[serde(default)]
    pub rotation: DVec3,
    /// How its surface looks.
    pub material: Material,
}

/// The form of a primitive in its own axes, centred on the origin. A form without area (a sphere of radius 0)
/// is allowed: it is dropped and counted when the scene is made ready for tracing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Shape {
    /// A flat rectangle in the xy plane, seen from both sides; its front looks along +z.
    Rectangle {
        /// Extent along x, metres.
        width: f64,
        /// Extent along y, metres.
        height: f64,
    },
    /// A box.
    Box {
        /// Extents along x, y and z, metres.
        size: DVec3,
    },
    /// A sphere.
    Sphere {
        /// Metres.
        radius: f64,
    },
    /// A closed cylinder around the z axis.
    Cylinder {
        /// Metres.
        radius: f64,
        /// Extent along z, metres.
        height: f64,
    },
}

/// How a surface looks: a matte (Lambertian) reflector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Its colours and their arrangement.
    pub pattern: Pattern,
    /// How strongly stains and wear vary the reflectance: 0 = clean, 1 = down to black.
    #[serde(default)]
    pub mottle: f32,
    /// Which of the endless variants of the pattern; two things with one seed look the same.
    #[serde(default)]
    pub seed: u32,
}

/// A procedural arrangement of colours on a surface, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Pattern {
    /// One colour: nothing for stereo to hold on to.
    Plain {
        /// The colour.
        colour: Rgb,
    },
    /// Squares of two colours in turn.
    Checker {
        /// The two colours.
        colours: [Rgb; 2],
        /// Edge of a square, metres.
        cell: f64,
    },
    /// Courses of bricks, each course shifted by half a brick, every brick a little different.
    Brick {
        /// Mean colour of the bricks.
        brick: Rgb,
        /// Colour of the joints.
        mortar: Rgb,
        /// Length of a brick with its joint, metres.
        length: f64,
        /// Height of a course with its joint, metres.
        height: f64,
        /// Width of a joint, metres.
        joint: f64,
    },
    /// Planks along x with grain.
    Wood {
        /// Early wood.
        light: Rgb,
        /// Late wood, the dark lines.
        dark: Rgb,
        /// Width of a plank, metres.
        plank: f64,
    },
    /// Value noise of several octaves: earth, leaves, concrete.
    Noise {
        /// Colour of the low values.
        dark: Rgb,
        /// Colour of the high values.
        light: Rgb,
        /// Wavelength of the coarsest octave, metres.
        scale: f64,
        /// Number of octaves, 1 to 12; each has half the wavelength and half the amplitude of the one before.
        octaves: u32,
    },
    /// A printed page on every face: a heading, lines of letters, a picture.
    Print {
        /// Colour of the page.
        paper: Rgb,
        /// Colour of the letters.
        ink: Rgb,
        /// Colour of the heading and the picture.
        accent: Rgb,
        /// Distance of two lines of text, metres.
        line: f64,
    },
}

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
}
