#![doc = include_str!("../README.md")]

mod config;
mod error;
mod prediction;

mod predict;

mod exposure;

mod cells;
mod closed_form;
mod shell;

pub use config::{Allocation, Backbone, Budget, Config, Head};
pub use depth_backbone::{DepthRange, ViewGeometry};
pub use entropy_sampler::Sampler;
pub use error::{Error, Result};
pub use predict::predict;
pub use prediction::{Counts, ExposureGain, Prediction, Stage, StageSeconds};
