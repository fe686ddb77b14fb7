#![doc = include_str!("../README.md")]

mod error;

mod anchors;
mod features;
mod lift;
mod normals;
mod views;

pub use anchors::{Anchors, Backprojected, Settings, anchors};
pub use error::{Error, Result};
pub use normals::{NormalFit, normals};
pub use views::{Dropped, ViewPixels};
