#![doc = include_str!("../README.md")]

mod config;
mod error;
mod inputs;
mod weights;

pub use config::{Config, HEADS, HEAD_WIDTH, Kind, LAYERS, OUTPUTS, WIDTH};
pub use error::{Error, Result};
pub use inputs::Inputs;
pub use weights::{Layout, Parameter, Weights};
