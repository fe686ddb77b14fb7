#![doc = include_str!("../README.md")]

mod error;
mod neighbors;

mod brute_force;
mod tree;

mod search;

#[cfg(target_arch = "x86_64")]
mod avx2;
mod candidates;

mod parallel;
mod scatter;

pub use brute_force::{brute_force, brute_force_query};
pub use error::{Error, Result};
pub use neighbors::{Neighbors, knn, query};
pub use tree::Tree;

#[cfg(test)]
#[path = "../tests/it/sets.rs"]
mod sets;
