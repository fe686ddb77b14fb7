use crate::Format;
use std::fmt;
use std::path::PathBuf;

/// What can be wrong with a scene file, or with a scene that is to become one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A PLY file breaks a rule, or the operating system refused.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
    /// A file breaks a rule of its format.
    #[error("{}: {format}: {rule}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The format that its first bytes or its extension say.
        format: Format,
        /// The rule.
        rule: Rule,
    },
    /// The file is in none of the formats.
    #[error("{}: no scene format is recognised by its first bytes, expected {}", path.display(), Format::LIST)]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// A path to write to whose extension names no format.
    #[error("{}: the extension names no scene format, expected {}", path.display(), Format::LIST)]
    Extension {
        /// The path.
        path: PathBuf,
    },
    /// A format cannot hold a scene.
    #[error("{format} cannot hold this scene: {rule}")]
    Unfit {
        /// The format.
        format: Format,
        /// The rule that the scene breaks.
        rule: Rule,
    },
}

/// What a Gaussian consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quantity {
    /// The mean, scene units.
    Position,
    /// The three standard deviations.
    Size,
    /// The quaternion.
    Rotation,
    /// The opacity.
    Opacity,
    /// The constant SH coefficients, as a colour.
    Colour,
    /// The other SH coefficients.
    Sh,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Size => "size",
            Self::Rotation => "rotation",
            Self::Opacity => "opacity",
            Self::Colour => "colour",
            Self::Sh => "spherical harmonics",
        })
    }
}

/// The rules of scene formats that can be broken. Gaussians are counted from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rule {
    /// A scene without Gaussians, which only PLY can hold.
    #[error("there are no Gaussians, expected at least one")]
    Empty,
    /// A number that no Gaussian can have.
    #[error("Gaussian {gaussian}: {quantity} is {found}, expected {expected}")]
    Value {
        /// Which Gaussian.
        gaussian: usize,
        /// What of it.
        quantity: Quantity,
        /// The number.
        found: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The file ends early.
    #[error("truncated: the header promises {promised} {what}, the data ends in number {found}")]
    Truncated {
        /// What is counted.
        what: &'static str,
        /// How many there should be.
        promised: u64,
        /// How many are complete.
        found: u64,
    },
    /// A `.splat` file whose length is no multiple of 32 bytes.
    #[error("truncated within Gaussian {gaussian}: the length is no multiple of 32 bytes")]
    Record {
        /// The last, incomplete Gaussian.
        gaussian: usize,
    },
    /// The file ends within its header.
    #[error("truncated within its header")]
    Header,
    /// There are bytes behind the end.
    #[error("there is data behind the last Gaussian")]
    Trailing,
    /// The first bytes are not those of the format.
    #[error("the first bytes are not those of the format")]
    Magic,
    /// A version that is not read.
    #[error("version {found} is not supported, expected {expected}")]
    Version {
        /// The version of the file.
        found: u32,
        /// The versions that are read.
        expected: &'static str,
    },
    /// Compressed data that is damaged.
    #[error("the compressed data is damaged: {reason}")]
    Compression {
        /// Why.
        reason: String,
    },
    /// Data that grows too much when it is decompressed or expanded.
    #[error(
        "the data grows to more than {most} times its size and more than 64 MiB: this is no honest scene file"
    )]
    Expansion {
        /// The largest ratio that is accepted.
        most: u64,
    },
    /// A number of the header is out of its range.
    #[error("{what} is {found}, expected {expected}")]
    Field {
        /// The field.
        what: &'static str,
        /// The number.
        found: u64,
        /// What is allowed.
        expected: &'static str,
    },
    /// A length that does not fit the other numbers of the file.
    #[error("{what} is {found}, expected {expected}")]
    Length {
        /// What is counted.
        what: &'static str,
        /// The number in the file.
        found: u64,
        /// What it should be.
        expected: u64,
    },
    /// A table of a compressed PLY file that is absent, or has other columns.
    #[error(
        "element {element:?} is missing or does not have the columns of a compressed PLY file: {columns}"
    )]
    Columns {
        /// Name of the element.
        element: &'static str,
        /// The columns that it must have.
        columns: &'static str,
    },
    /// The JSON of a glTF file is broken.
    #[error("the JSON is broken: {reason}")]
    Json {
        /// Why.
        reason: String,
    },
    /// An index of a glTF file that leads nowhere.
    #[error("{what} {index} does not exist or is used twice where it may be used once")]
    Index {
        /// What is numbered.
        what: &'static str,
        /// The index.
        index: usize,
    },
    /// A part of a glTF file does not lie within the file.
    #[error("{what} {index} reaches beyond the data that it lies in")]
    Range {
        /// `buffer view` or `accessor`.
        what: &'static str,
        /// Its index.
        index: usize,
    },
    /// An attribute that every Gaussian of a glTF file has is absent.
    #[error("attribute {name:?} is missing")]
    Attribute {
        /// The attribute.
        name: String,
    },
    /// An accessor of a type that its attribute does not have.
    #[error("accessor {index}: type {found:?} is not supported for {name:?}")]
    Accessor {
        /// Index of the accessor.
        index: usize,
        /// Its type and component type.
        found: String,
        /// The attribute.
        name: String,
    },
    /// A feature that is not read.
    #[error("{what} {found:?} is not supported")]
    Unsupported {
        /// Which kind of feature.
        what: &'static str,
        /// Its name.
        found: String,
    },
    /// A node of a glTF file that does more than turn, move and scale by one factor.
    #[error("node {node} mirrors, shears or scales its axes differently, which is not supported")]
    Transform {
        /// Index of the node.
        node: usize,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a file is not read, before its path is known.
#[derive(Debug)]
pub(crate) enum Fault {
    Rule(Rule),
    Io(std::io::Error),
}

impl From<Rule> for Fault {
    fn from(rule: Rule) -> Self {
        Self::Rule(rule)
    }
}

impl From<std::io::Error> for Fault {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}
