#![doc = include_str!("../README.md")]

mod error;

mod dropped;
mod window;

mod plan;
mod simulated;

mod geometry_cache;
mod hash;

pub use dropped::Dropped;
pub use error::{Error, Result};
pub use geometry_cache::GeometryCache;
pub use hash::{file_sha256, hexadecimal, sha256_of};
pub use plan::{ALONG_A_VIDEO, Choice, Plan, Reading, Windows, scene_of};
pub use simulated::{SIMULATED_SIZE, SimulatedScene, simulated_context, simulated_window};
pub use window::Window;
