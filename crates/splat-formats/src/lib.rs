#![doc = include_str!("../README.md")]

mod compressed_ply;
mod error;
mod file;
mod format;
mod glb;
mod loss;
mod numbers;
mod splat;
mod spz;
mod turn;

pub use error::{Error, Quantity, Result, Rule};
pub use file::{Encoder, Remark, Scene, read_scene, write_scene};
pub use format::Format;
pub use loss::Loss;
pub use turn::{HalfTurn, Similarity, half_turn};
