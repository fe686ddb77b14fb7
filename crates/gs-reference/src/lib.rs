#![doc = include_str!("../README.md")]

mod case;
mod compare;
mod naive;
mod profile;
mod project;
mod sh;
pub mod tolerance;

pub use case::{Case, Expected};
pub use compare::{Deviation, Mismatch, compare, compare_exactly};
pub use naive::{Reference, render};
pub use profile::Profile;
pub use project::{Projected, project};
pub use sh::basis;
