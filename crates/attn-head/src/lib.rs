#![doc = include_str!("../README.md")]

mod config;
mod draw;
mod error;
mod file;
pub mod fused;
mod head;
mod inputs;
mod layout;
#[cfg(feature = "candle")]
pub mod plain;
mod weights;

pub use config::{CELL_WIDTH, Config, HEAD_WIDTH, HEADS, Kind, MESSAGE, OUTPUTS, WIDTH};
pub use error::{Error, Result};
pub use head::Head;
pub use inputs::Inputs;
pub use layout::{LAST_LAYER, Layout, Parameter};
pub use tensor_files::{SafetensorsFault, WeightFault, WeightProblem};
pub use weights::Weights;
