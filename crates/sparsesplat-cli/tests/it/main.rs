//! The binary as a user calls it.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, as tests do")]

#[cfg(feature = "candle")]
mod benches;
mod data;
#[cfg(feature = "candle")]
mod depthsplat;
mod devices;
mod formats;
mod hostile;
mod jobs;
mod lpips;
#[path = "../../../image-metrics/tests/it/recipe.rs"]
#[allow(dead_code, reason = "also compares files of picture pairs")]
mod lpips_recipe;
mod outputs;
mod paper;
mod poses;
mod settings;
mod streaming;
mod tiny;
mod tradeoff;
#[cfg(feature = "candle")]
mod training;
mod viewing;
#[cfg(not(feature = "candle"))]
mod without_candle;
