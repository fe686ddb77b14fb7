//! Photographs of simulated scenes: their poses are known.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, as tests do")]

#[cfg(feature = "openmvg")]
mod openmvg;
mod photographs;
mod scenes;
mod video;
