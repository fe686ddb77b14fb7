#![doc = include_str!("../README.md")]

mod backbone;
mod error;

mod given_depth;
mod plane_sweep;

mod range;
mod sources;

mod pair;
mod resolution;
mod texture;

mod cost;
mod sgm;

mod confirm;
mod consistency;
mod fill;
mod fuse;

mod learned;

#[cfg(feature = "depthsplat")]
mod depthsplat;

mod estimate;
mod features;

pub use backbone::{DepthBackbone, NetworkDevice, ViewGeometry, Wanted};
pub use consistency::Tolerance;
#[cfg(feature = "depthsplat")]
pub use depthsplat::{
    DepthSplat, NamedTensor, PixelGaussians, Scales, StageTime, Trace, Variant, Vit, WeightFault,
    WeightProblem,
};
pub use error::{Error, Result};
pub use features::{FEATURE_NAMES, Features};
pub use fuse::{FusedView, fuse};
pub use given_depth::GivenDepth;
pub use learned::{Decoded, DepthNetwork, DepthWeights, InputParts, Inputs, Recorded};
pub use pair::Pair;
pub use plane_sweep::PlaneSweep;
pub use range::{DepthRange, FAR_MARGIN};
