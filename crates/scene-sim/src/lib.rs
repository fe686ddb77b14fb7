#![doc = include_str!("../README.md")]

mod error;

mod check;
mod demo;
mod noise;
mod render;
mod scene;
mod shape;
mod stage;
mod texture;
mod trace;
mod trajectory;
mod varied;

pub use demo::{demo_cameras, demo_scene};
pub use error::{Error, Result};
pub use render::{RayCounts, render_counted, render_view};
pub use scene::{Material, Pattern, Primitive, Rgb, Scene, Shape, Sky, Sun};
pub use trace::Traced;
pub use trajectory::{Trajectory, lens};
pub use varied::{varied_cameras, varied_scene};
