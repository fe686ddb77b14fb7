#![doc = include_str!("../README.md")]

mod error;

mod brute_force;
mod neighbors;
mod search;
mod tree;

pub use brute_force::brute_force;
pub use error::{Error, Result};
pub use neighbors::{Neighbors, knn, query};
