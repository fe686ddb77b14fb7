//! The list of invisible parts of a description.

use std::fmt;

/// Something of a scene that is not seen, and how much of it there is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dropped {
    /// Which part of the scene: `primitive 3 (table top)`, `mesh 0 (chair)`.
    pub place: String,
    /// What is not seen.
    pub what: Omission,
    /// How many of them.
    pub count: u64,
}

/// The kinds of things that are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Omission {
    /// A primitive without area.
    Primitive,
    /// Triangles of a mesh with two corners in one place.
    Triangles,
    /// A mesh without any triangle.
    Mesh,
    /// Lines of an OBJ file that name materials: a mesh has the material of the description.
    Materials,
    /// Lines of an OBJ file of a kind that is not read (curves, points, groups are not among them).
    Lines,
    /// Corners without texture coordinates in a file that has some: the whole mesh does without.
    Coordinates,
    /// Elements of a PLY file other than vertices and faces.
    Elements,
    /// Bytes behind the last element of a PLY file.
    Bytes,
}

impl fmt::Display for Dropped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { place, what, count } = self;
        match what {
            Omission::Primitive => write!(f, "{place} has no area and is not seen"),
            Omission::Triangles => write!(f, "{place}: {count} triangles have two corners in one place"),
            Omission::Mesh => write!(f, "{place} has no triangles and is not seen"),
            Omission::Materials => write!(f, "{place}: {count} lines that name materials are ignored"),
            Omission::Lines => write!(f, "{place}: {count} lines of a kind that is not read"),
            Omission::Coordinates => {
                write!(f, "{place}: {count} corners have no texture coordinates, so none are used")
            }
            Omission::Elements => write!(f, "{place}: {count} elements that are neither vertices nor faces"),
            Omission::Bytes => write!(f, "{place}: {count} bytes behind the last element"),
        }
    }
}
