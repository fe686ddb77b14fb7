#![doc = include_str!("../README.md")]

mod config;
mod error;
mod update;

mod mapper;

mod bootstrap;
mod look;
mod stereo;

mod compare;
mod draw;
mod fuse;

mod map;
mod room;

mod covisibility;
mod keyframes;

mod snapshot;

pub use config::{Config, Depth};
pub use error::{Error, Result};
pub use map::BYTES;
pub use mapper::{Frame, Mapper};
pub use snapshot::Snapshot;
pub use update::{Integrated, Outcome, Refusal, Seen, Update, Waiting};
