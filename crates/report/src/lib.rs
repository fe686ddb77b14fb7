#![doc = include_str!("../README.md")]

mod figures_table;
mod plot;
mod report;
mod training_plot;

#[cfg(test)]
mod fixture;

pub use figures_table::figures_table;
pub use plot::refinement_plot;
pub use report::{PictureLimits, Report};
pub use report_parts::{Error, Result};
pub use training_plot::training_plot;
