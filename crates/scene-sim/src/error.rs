/// What can be wrong with a scene description or a request to render it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number of the description is NaN, infinite or out of its range.
    #[error("{place}: {field} is {found}, expected {expected}")]
    Value {
        /// Which part of the scene, with its name: `primitive 3 (table top)`, `sun`, `sky`, `trajectory`.
        place: String,
        /// Which field of it.
        field: &'static str,
        /// The number given.
        found: f64,
        /// What is allowed there.
        expected: &'static str,
    },
    /// A description of another version.
    #[error("the description has version {found}, only version {expected} is read")]
    Version {
        /// The number given.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// A view without samples, or with more than are of use.
    #[error("samples per pixel are {found}, expected 1 to 4096")]
    Samples {
        /// The number given.
        found: u32,
    },
    /// Polygons of the description break a rule.
    #[error("{place}: {rule}")]
    Polygons {
        /// Which mesh, with its name: `mesh 0 (chair)`.
        place: String,
        /// The rule, with expected and found.
        rule: MeshRule,
    },
    /// A mesh comes from a file, but the description came without a folder.
    #[error("{place}: its polygons are in a file, which needs the folder of the description (Traced::load)")]
    NoFolder {
        /// Which mesh, with its name.
        place: String,
    },
    /// A scene too large to be numbered.
    #[error("the scene has {found} vertices or triangles, expected at most {most}")]
    TooLarge {
        /// The larger of the numbers of vertices and of triangles and bodies.
        found: u64,
        /// What is allowed.
        most: u64,
    },
    /// A camera, image or view that gs-scene refuses.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// The rules that polygons and their files can break. Vertices and faces are counted from 0, lines from 1.
#[derive(Debug, thiserror::Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum MeshRule {
    /// A polygon with too few corners.
    #[error("face {face} has {found} corners, expected three or more")]
    FaceCorners {
        /// Which polygon.
        face: u64,
        /// Its corners.
        found: u64,
    },
    /// A polygon names a vertex that is not there.
    #[error("face {face} names vertex {found}, but there are {vertices}")]
    FaceIndex {
        /// Which polygon.
        face: u64,
        /// The index given.
        found: i64,
        /// Number of vertices.
        vertices: u64,
    },
    /// A polygon that is too large to be cut into triangles.
    #[error("face {face} is concave with {found} corners, expected at most 256 unless it is convex")]
    FaceConcave {
        /// Which polygon.
        face: u64,
        /// Its corners.
        found: u64,
    },
    /// A number of colours that fits nothing.
    #[error("{found} colours for {vertices} vertices, expected one for each or none")]
    Colours {
        /// Number of colours.
        found: u64,
        /// Number of vertices.
        vertices: u64,
    },
}

/// The result of what can fail in this crate.
pub type Result<T> = std::result::Result<T, Error>;
