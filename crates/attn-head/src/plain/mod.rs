//! The heads in ordinary operations of candle: every kind, f32 or f64, on any device, differentiable by the weights and
//! by all inputs. The tests compare the fused path with it.

mod blocks;
mod inputs;
mod network;
mod ops;

pub use inputs::TensorInputs;
pub use network::{Network, Trace};
