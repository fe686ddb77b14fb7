//! Meshes as a description states them.

mod obj;
mod ply;
pub(crate) mod polygons;
pub(crate) mod read;

use crate::{Material, Rgb};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A surface of polygons in its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mesh {
    /// What errors call it.
    pub name: String,
    /// Its polygons.
    pub source: MeshSource,
    /// Where the origin of its own axes lies in the world, metres.
    #[serde(default)]
    pub centre: DVec3,
    /// Turns about the world's x, then y, then z axis, degrees.
    #[serde(default)]
    pub rotation: DVec3,
    /// Metres per unit of its own.
    #[serde(default = "one")]
    pub scale: f64,
    /// How its surface looks. Patterns are laid on by the mesh's own coordinates (noise, wood), or by its texture
    /// coordinates where they need a plane and the mesh has them (one unit is a metre); else each face is taken by the
    /// axis that it faces most, as the sides of a box are.
    pub material: Material,
}

fn one() -> f64 {
    1.0
}

/// Where the polygons of a mesh come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum MeshSource {
    /// A PLY or OBJ file, relative to the folder of the description.
    File(String),
    /// Polygons in the description itself.
    Inline {
        /// Vertices in the mesh's own units.
        vertices: Vec<DVec3>,
        /// Flat polygons of three or more vertices, counter-clockwise from outside. Both sides are seen.
        faces: Vec<Vec<u32>>,
        /// One colour per vertex, or none at all.
        #[serde(default)]
        colours: Vec<Rgb>,
    },
}

#[cfg(test)]
mod file_tests;
