//! The heads as models of candle: every kind, f32 or f64, on any device, differentiable by the weights and
//! by all inputs. [`fused`](crate::fused) is faster, and is compared with it by the tests.

mod gather;
mod inputs;
mod layers;
mod network;

pub use inputs::TensorInputs;
pub use network::{Network, Trace};
