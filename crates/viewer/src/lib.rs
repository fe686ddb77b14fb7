#![doc = include_str!("../README.md")]

mod error;
mod pack;
mod page;
mod path;
mod serve;

pub use error::{Error, Result};
pub use pack::{Precision, packed, unpacked};
pub use page::{Near, Page, Shot, Still};
pub use path::{along, around, fullest, overview};
pub use serve::Server;
