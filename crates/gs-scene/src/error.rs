use std::path::PathBuf;

/// What can be wrong with a camera, an image, a scene or a PLY file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A focal length is zero, negative, NaN or infinite.
    #[error("focal length {name} is {found}, expected a finite number above 0")]
    Focal {
        /// `fx` or `fy`.
        name: &'static str,
        /// The value given, in pixels.
        found: f64,
    },
    /// A principal point is NaN or infinite.
    #[error("principal point {name} is {found}, expected a finite number")]
    PrincipalPoint {
        /// `cx` or `cy`.
        name: &'static str,
        /// The value given, in pixels.
        found: f64,
    },
    /// A camera or picture without pixels.
    #[error("size is {width}x{height}, expected at least one pixel and at most 2^31")]
    Size {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A pose holds a NaN or an infinity.
    #[error("pose is not finite")]
    PoseNotFinite,
    /// The rotation of a pose is not a rotation.
    #[error("rotation is not orthonormal: |R Rᵀ - I| is {deviation:.2e}, expected at most 1e-4")]
    NotOrthonormal {
        /// Largest absolute entry of `R Rᵀ - I`.
        deviation: f64,
    },
    /// The rotation of a pose mirrors (determinant -1).
    #[error("rotation mirrors the scene: its determinant is -1, expected +1")]
    Mirrored,
    /// A buffer's length does not fit the stated shape.
    #[error("{what} holds {found} numbers, expected {expected}")]
    Length {
        /// Which buffer.
        what: &'static str,
        /// Numbers needed by the shape.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// Spherical harmonics beyond degree 3.
    #[error("SH degree is {found}, expected 0 to 3")]
    ShDegree {
        /// The degree given.
        found: usize,
    },
    /// A view's picture, camera and depth do not have the same size.
    #[error("view {view}: {what} is {found_width}x{found_height}, the camera says {width}x{height}")]
    SizeMismatch {
        /// Name of the view.
        view: String,
        /// `image` or `depth`.
        what: &'static str,
        /// Camera's width.
        width: usize,
        /// Camera's height.
        height: usize,
        /// Width found.
        found_width: usize,
        /// Height found.
        found_height: usize,
    },
    /// A PLY file breaks a rule of the format.
    #[error("{}: {rule}", path.display())]
    Ply {
        /// The file.
        path: PathBuf,
        /// The rule, with expected and found.
        rule: PlyRule,
    },
    /// The operating system refused.
    #[error("{}: cannot {action}", path.display())]
    Io {
        /// What was tried: `read`, `write` …
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
}

/// The rules of a PLY file, and of one with 3D Gaussians, that can be broken.
#[derive(Debug, thiserror::Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlyRule {
    /// The first line is not `ply`.
    #[error("not a PLY file (the first line is not \"ply\")")]
    Magic,
    /// The header does not end within the first 64 KiB.
    #[error("the header has no end_header line within its first 64 KiB")]
    HeaderEnd,
    /// A header line that cannot be understood, or names an element or property for the second time.
    #[error("header line {line} is not understood: {found:?}")]
    HeaderLine {
        /// Which line, from 1.
        line: u64,
        /// The line.
        found: String,
    },
    /// The header says nothing about how numbers are written.
    #[error("the header has no format line")]
    NoFormat,
    /// A way to write numbers that is unknown, or that is not read here.
    #[error("format {found:?} is not supported, expected binary_little_endian 1.0 or ascii 1.0")]
    Format {
        /// The format line's words.
        found: String,
    },
    /// No `element vertex` in the header, or it is not the first element.
    #[error("the first element must be \"vertex\"")]
    NoVertex,
    /// A list where every row has one number.
    #[error("{element} property {name:?} is a list, expected a number")]
    ListProperty {
        /// Name of the element.
        element: String,
        /// The property.
        name: String,
    },
    /// A property that every 3DGS file has is absent.
    #[error("vertex property {name:?} is missing: not a 3D Gaussian scene")]
    MissingProperty {
        /// The property.
        name: String,
    },
    /// The number of `f_rest_*` properties is not 0, 9, 24 or 45.
    #[error("{found} f_rest properties, expected 0, 9, 24 or 45")]
    RestCount {
        /// How many there are.
        found: usize,
    },
    /// The file ends before the last vertex.
    #[error("truncated: the header promises {promised} vertices, the data ends in vertex {found}")]
    Truncated {
        /// Vertices in the header.
        promised: u64,
        /// Complete vertices found.
        found: u64,
    },
    /// An ASCII value that is no number.
    #[error("vertex {vertex}: {found:?} is not a number")]
    Number {
        /// Index of the vertex.
        vertex: u64,
        /// The word.
        found: String,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
