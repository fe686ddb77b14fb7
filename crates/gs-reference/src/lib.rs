#![doc = include_str!("../README.md")]

mod case;
mod compare;
mod error;
mod naive;
mod profile;
pub mod tolerance;

pub use case::{Case, Expected, GoldenGradient, Loss};
pub use compare::{Deviation, Mismatch, compare, compare_exactly};
pub use error::{Error, Result};
pub use naive::{
    PixelGradients, Projected, Reference, ReferenceGradients, Variable, backward, basis, project, render,
};
pub use profile::{Profile, ShAxes};
