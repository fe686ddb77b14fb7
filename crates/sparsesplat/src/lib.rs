#![doc = include_str!("../README.md")]

mod config;
mod error;
mod prediction;

mod predict;

pub use config::{Allocation, Backbone, Budget, Config, DepthRange, Head, Sampler};
pub use error::{Error, Result};
pub use predict::predict;
pub use prediction::{Counts, ExposureGain, Prediction, Stage, StageSeconds};
