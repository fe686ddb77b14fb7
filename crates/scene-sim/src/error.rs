use std::path::PathBuf;

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
    /// A file holds a description that is refused.
    #[error("{}: {problem}", path.display())]
    Description {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: Box<Error>,
    },
    /// A text that is no description.
    #[error("line {line}, column {column}: {reason}")]
    Syntax {
        /// Counted from 1.
        line: usize,
        /// Counted from 1.
        column: usize,
        /// What is wrong there.
        reason: Box<ron::Error>,
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
    /// A mesh file breaks a rule of its format.
    #[error("{place}: {}: {rule}", path.display())]
    MeshFile {
        /// Which mesh, with its name.
        place: String,
        /// The file.
        path: PathBuf,
        /// The rule, with expected and found.
        rule: MeshRule,
    },
    /// The operating system refused.
    #[error("{}: cannot {action}", path.display())]
    Io {
        /// What was tried: `read`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// The mirrors of a Replica room are not a list of surfaces.
    #[error("{}: not a list of mirrors and panes", path.display())]
    GlassSur {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        #[source]
        source: Box<serde_json::Error>,
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
    /// A lens whose distortion takes two directions to one place of the picture, or none.
    #[error("photographs: the distortion has no inverse at pixel ({x}, {y})")]
    Folded {
        /// Pixels from the left edge.
        x: f64,
        /// Pixels from the top edge.
        y: f64,
    },
    /// A picture that is not one of the photographs.
    #[error("photographs: picture {found} is asked for, there are {count}, counted from 0")]
    Picture {
        /// The number given.
        found: usize,
        /// How many there are.
        count: usize,
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
    #[error("face {face} is concave with {found} corners, expected at most 1024 unless it is convex")]
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
    /// A vertex that is nowhere, or too far away.
    #[error(
        "vertex {vertex}: a coordinate is {found}, expected a finite number of magnitude up to 1e9 metres"
    )]
    Vertex {
        /// Which vertex.
        vertex: u64,
        /// The coordinate, metres.
        found: String,
    },
    /// A texture coordinate that is nowhere, or too far away.
    #[error("vertex {vertex}: a texture coordinate is not a finite number of magnitude up to 1e9")]
    Coordinate {
        /// Which vertex.
        vertex: u64,
    },
    /// A colour channel out of its range.
    #[error(
        "vertex {vertex}: a colour channel is {found}, expected 0 to 1 (floats) or 0 to the largest integer"
    )]
    Colour {
        /// Which vertex.
        vertex: u64,
        /// The channel as a share of its largest value.
        found: String,
    },
    /// More vertices than can be numbered.
    #[error("there are {found} vertices or more, expected less than 2^32")]
    TooMany {
        /// How many.
        found: u64,
    },
    /// A file of a kind that is not read.
    #[error("the file's extension is {found:?}, expected ply or obj")]
    Extension {
        /// The extension.
        found: String,
    },
    /// The header of a PLY file breaks a rule.
    #[error(transparent)]
    Ply(gs_scene::PlyRule),
    /// Something that a mesh needs is not in the header.
    #[error("the header lacks {what}")]
    PlyMissing {
        /// What is missing.
        what: &'static str,
    },
    /// A list where one number belongs.
    #[error("vertex property {name:?} is a list, expected a number")]
    PlyList {
        /// The property.
        name: String,
    },
    /// The header promises more than the file can hold.
    #[error("the header promises at least {promised} bytes of data, the file holds {found}")]
    PlySize {
        /// The fewest bytes that the elements of the header take.
        promised: u64,
        /// Bytes behind the header.
        found: u64,
    },
    /// The file ends too early.
    #[error(
        "truncated: the header promises {promised} of element {element:?}, the data ends in number {found}"
    )]
    PlyTruncated {
        /// The element.
        element: String,
        /// How many the header promises.
        promised: u64,
        /// How many are complete.
        found: u64,
    },
    /// A word that is no number of its type.
    #[error("element {element:?} {index}: {found:?} is not a number of the declared type")]
    PlyNumber {
        /// The element.
        element: String,
        /// Which of them.
        index: u64,
        /// The word.
        found: String,
    },
    /// A face with a number of corners that no polygon has.
    #[error("face {face} has {found} corners, expected 3 to 65536")]
    PlyLength {
        /// Which face.
        face: u64,
        /// The length of its list.
        found: i64,
    },
    /// A line that does not end.
    #[error("line {line} is longer than 1 MiB with its continuations")]
    ObjLong {
        /// Where it begins.
        line: u64,
    },
    /// A word that is no number.
    #[error("line {line}: {found:?} is not a number")]
    ObjNumber {
        /// Which line.
        line: u64,
        /// The word.
        found: String,
    },
    /// A line with too few or too many numbers.
    #[error("line {line} has {found} numbers, expected {expected}")]
    ObjCount {
        /// Which line.
        line: u64,
        /// How many there are.
        found: u64,
        /// What is allowed.
        expected: &'static str,
    },
    /// An index that names nothing above its line.
    #[error("line {line} names number {found}, but there are {count} above it")]
    ObjIndex {
        /// Which line.
        line: u64,
        /// The index in the file: from 1, or from -1 backwards.
        found: i64,
        /// How many vertices or texture coordinates there are so far.
        count: u64,
    },
}

/// The result of what can fail in this crate.
pub type Result<T> = std::result::Result<T, Error>;
