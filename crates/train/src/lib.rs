#![doc = include_str!("../README.md")]

mod adam;
mod cases;
mod checkpoint;
mod config;
pub mod depth;
mod disturb;
mod draw;
mod error;
mod loss;
mod net;
mod ops;
mod photographs;
mod prepared;
mod ranks;
mod recolour;
mod sources;
mod trainer;

pub use adam::Rates;
pub use cases::{Case, Cases};
pub use config::Config;
pub use error::{Error, Result};
pub use ranks::Ranks;
pub use trainer::{Look, Record, Score, Trainer};
