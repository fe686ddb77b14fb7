#![doc = include_str!("../README.md")]

mod case;
mod compare;
mod error;
mod naive;
mod profile;
pub mod tolerance;

// One twin per shader pass, in the order in which a view goes through them, and what they share.
mod alpha;
pub mod bin;
pub mod chain;
mod ewa;
pub mod frame;
mod grid;
pub mod project;
pub mod project_backward;
pub mod rasterize_backward;
pub mod rasterize_ellipsoids;
pub mod rasterize_forward;
pub mod scan;
mod sh;
pub mod sort;
pub mod tile_ranges;

pub use case::{Case, Expected, GoldenGradient, Loss};
pub use compare::{Deviation, Mismatch, compare, compare_exactly, compare_to_size};
pub use error::{Error, Result};
pub use naive::{
    PixelGradients, Projected, Reference, ReferenceEllipsoids, ReferenceGradients, Solid, Variable, backward,
    basis, project, render, render_ellipsoids,
};
pub use profile::{Profile, ShAxes};
