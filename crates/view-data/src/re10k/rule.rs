//! Rules of camera files of RealEstate10K.

use crate::CameraRule;

/// The rules of a camera file that can be broken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Re10kRule {
    /// The file is no text.
    #[error("is not UTF-8 text")]
    NotText,
    /// No line after the first.
    #[error("has no cameras, expected an URL and then one line per frame")]
    NoCameras,
    /// A line of another number of columns.
    #[error("has {found} columns, expected 19: timestamp, fx fy cx cy 0 0, 3x4 world-to-camera")]
    Columns {
        /// How many it has.
        found: usize,
    },
    /// A column that is no number.
    #[error("column {column} is {found:?}, expected a number")]
    Number {
        /// The column, from 0.
        column: usize,
        /// What it holds, cut.
        found: String,
    },
    /// A timestamp that is no whole number of microseconds.
    #[error("timestamp is {found:?}, expected a whole number of microseconds")]
    Timestamp {
        /// What it holds, cut.
        found: String,
    },
    /// Two lines of one timestamp.
    #[error("timestamp {timestamp} occurs twice")]
    DuplicateTimestamp {
        /// The timestamp, microseconds.
        timestamp: u64,
    },
    /// No picture of any frame: the intrinsics are relative to their size.
    #[error("none of the {frames} pictures is there; expected {folder}/<timestamp>.png or .jpg")]
    NoPictures {
        /// Frames of the file.
        frames: usize,
        /// The folder that was looked into.
        folder: String,
    },
    /// A camera breaks a rule.
    #[error("{0}")]
    Camera(CameraRule),
}
