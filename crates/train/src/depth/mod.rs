//! Training of the network behind the plane sweep ([`depth_backbone::DepthNetwork`]) on simulated scenes, whose depth is exact, and on
//! photographs, with or without measured depth.

mod between;
mod cases;
mod loss;
mod score;
mod trainer;

pub use cases::DepthCases;
pub use score::DepthScore;
pub use trainer::{DepthConfig, DepthRecord, DepthTrainer};
