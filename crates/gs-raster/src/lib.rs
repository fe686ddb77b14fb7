#![doc = include_str!("../README.md")]

mod error;
mod settings;

mod render;

mod cpu;

pub use error::{Error, Result};
pub use render::{RenderStats, Rendering, StageSeconds, render};
pub use settings::RenderSettings;
