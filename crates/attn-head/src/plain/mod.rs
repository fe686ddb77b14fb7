//! The heads as models of candle: every kind, f32 or f64, on any device, differentiable by the weights and
//! by all inputs. The tests compare the fused path with it.

mod gather;
mod inputs;
mod layers;
mod network;

pub use inputs::TensorInputs;
pub use network::{Network, Trace};
