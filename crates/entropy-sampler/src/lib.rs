#![doc = include_str!("../README.md")]

mod error;

mod blue_noise;
mod border;
mod entropy;
mod fixed;
mod hilbert;
mod importance;
mod parallel;
mod probability;
mod random;
mod sample;

pub use border::Border;
pub use entropy::{EntropyWindow, entropy};
pub use error::{Error, Result};
pub use importance::ImportanceMap;
pub use probability::{Probability, solve};
pub use sample::{Budget, Sampler, Samples, sample, sample_per_view};
