#![doc = include_str!("../README.md")]

mod error;
mod settings;

mod gradients;
mod rasterizer;
mod render;

mod cpu;

pub use error::{Error, Result};
pub use gradients::{Gradients, PixelGradients, PoseGradient};
pub use rasterizer::{Rasterizer, Tape};
pub use render::{RenderStats, Rendering, StageSeconds, render};
pub use settings::RenderSettings;
