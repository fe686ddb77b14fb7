#![doc = include_str!("../README.md")]

mod backbone;
mod error;

pub use backbone::{DepthBackbone, ViewGeometry};
pub use error::{Error, Result};
