//! Training of the network behind the plane sweep ([`depth_backbone::DepthNetwork`]) on simulated scenes, whose depth is exact.

mod cases;
mod loss;
mod score;
mod trainer;

pub use cases::DepthCases;
pub use score::DepthScore;
pub use trainer::{DepthConfig, DepthRecord, DepthTrainer};
