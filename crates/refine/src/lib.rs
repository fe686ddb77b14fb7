#![doc = include_str!("../README.md")]

mod config;
mod error;
mod report;

mod refine;

mod adam;
mod between;
mod damping;
mod exposure;
mod half;
mod limits;
mod loss;
mod objective;
mod poses;
mod schedule;

pub use config::{ColourTerm, Config, Loss, Rates, Stop};
pub use error::{Error, Result};
pub use exposure::Exposure;
pub use poses::PoseChange;
pub use refine::{Refined, prune, refine};
pub use report::{Report, Step, StepRecord, Stopped};

#[cfg(test)]
#[path = "../tests/it/scenes.rs"]
mod scenes;
