#![doc = include_str!("../README.md")]

mod error;

pub mod chart;
pub mod colour;
pub mod labels;
pub mod page;

mod picture;
mod table;

pub use error::{Error, Result};
pub use picture::{DepthScale, ERROR_GAIN, Picture};
pub use table::{Table, count, decibel, lpips_column, number};
