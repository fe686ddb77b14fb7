#![doc = include_str!("../README.md")]

mod error;
mod neighbors;

mod brute_force;
mod grid;
mod nearest;
mod search;

mod parallel;

pub use brute_force::brute_force;
pub use error::{Error, Result};
pub use neighbors::{Anchors, Neighbors, Settings, neighbors};
