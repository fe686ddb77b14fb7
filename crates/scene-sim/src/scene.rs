//! The description of a scene: plain data, which a person can write by hand.

use crate::{Lamp, Material, Mesh, Photographs, Sky, Sun};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The version of the description that this crate writes and reads.
pub const SCENE_VERSION: u32 = 1;

/// Things under lights and a sky, and how they are photographed. Lengths are metres, angles degrees, and the
/// world's z axis points up.
///
/// An effect is simulated where the description calls for it and costs nothing where it does not: what is left
/// out of the file is not there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// [`SCENE_VERSION`].
    pub version: u32,
    /// Solid things; may be empty.
    #[serde(default)]
    pub primitives: Vec<Primitive>,
    /// Things made of polygons.
    #[serde(default)]
    pub meshes: Vec<Mesh>,
    /// A sun, if it shines.
    #[serde(default)]
    pub sun: Option<Sun>,
    /// Lamps with a place.
    #[serde(default)]
    pub lamps: Vec<Lamp>,
    /// The background, and the light that comes from all sides.
    pub sky: Sky,
    /// How the scene is photographed, where it brings its own path and camera.
    #[serde(default)]
    pub photographs: Option<Photographs>,
}

impl Scene {
    /// A scene with nothing in it.
    #[must_use]
    pub fn under(sky: Sky) -> Self {
        Self {
            version: SCENE_VERSION,
            primitives: Vec::new(),
            meshes: Vec::new(),
            sun: None,
            lamps: Vec::new(),
            sky,
            photographs: None,
        }
    }
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
