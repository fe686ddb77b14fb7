#![doc = include_str!("../README.md")]

mod error;
mod settings;

mod activated;
mod gradients;
mod near;
mod rasterizer;
mod render;

mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;

pub use activated::{Activated, Colors};
pub use error::{Error, Result};
pub use gradients::{ActivatedGradients, CameraGradient, Gradients, PixelGradients};
pub use near::{NEAR_SAMPLE, NEAR_SHARE, near_plane};
pub use rasterizer::{Device, Rasterizer, Tape};
pub use render::{RenderStats, Rendering, StageSeconds, TILE};
pub use settings::{ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, RenderSettings, SLOPE_MARGIN, Style};
