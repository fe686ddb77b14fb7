//! Rules of evaluation indices.

/// The rules of an evaluation index that can be broken.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum IndexRule {
    /// The file has no entries.
    #[error("has no entries")]
    Empty,
    /// A key occurs twice.
    #[error("key occurs twice")]
    DuplicateKey,
    /// An entry is not `{"context": [..], "target": [..]}` or null.
    #[error("entry is not null or an object with lists \"context\" and \"target\" of frame positions")]
    Entry,
    /// A list without positions.
    #[error("{list} is empty")]
    EmptyList {
        /// `context` or `target`.
        list: &'static str,
    },
    /// A position occurs twice in a list.
    #[error("{list} names frame position {position} twice")]
    Duplicate {
        /// `context` or `target`.
        list: &'static str,
        /// The position.
        position: usize,
    },
    /// A position beyond the frames of the scene.
    #[error("{list} names frame position {position}, but {scene} has {frames} frames (0 to {})", frames.saturating_sub(1))]
    Position {
        /// `context` or `target`.
        list: &'static str,
        /// The position.
        position: usize,
        /// Name of the data set.
        scene: String,
        /// Its number of frames.
        frames: usize,
    },
    /// No entry for a scene.
    #[error("no usable entry for scene {scene}, only for: {}", known.join(", "))]
    UnknownScene {
        /// The scene.
        scene: String,
        /// The scenes that have entries.
        known: Vec<String>,
    },
}
