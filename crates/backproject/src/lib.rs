#![doc = include_str!("../README.md")]

mod error;

mod anchors;
mod normals;

pub use anchors::{Anchors, anchors};
pub use error::{Error, Result};
pub use normals::{NormalFit, normals};
