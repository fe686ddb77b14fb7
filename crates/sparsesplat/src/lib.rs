#![doc = include_str!("../README.md")]

mod config;
mod error;
mod prediction;
mod stage;

mod anchored;
mod backbone;
mod own_head;
mod predictor;

pub mod learned;

mod as_photographed;
mod exposure;
mod harmonics;

mod cells;
mod closed_form;
mod looks;
mod merge;
mod shell;
mod voxels;

pub use anchored::{Anchored, anchor};
pub use backbone::Geometry;
pub use config::{Allocation, Backbone, Budget, Config, Correction, Exposure, Head, SweepDepth};
pub use depth_backbone::{DepthRange, Features, NetworkDevice, ViewGeometry, Wanted};
pub use entropy_sampler::Sampler;
pub use error::{Error, Result};
pub use merge::{COLOUR_SCALE, Cluster};
pub use prediction::{Counts, ExposureGain, Prediction};
pub use predictor::Predictor;
pub use stage::{Stage, StageSeconds, Stages};
