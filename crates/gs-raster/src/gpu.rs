//! The GPU path: the passes of gs-shaders on any adapter that wgpu finds.

mod adapter;
mod backward;
mod context;
mod forward;
mod frame;
mod passes;
mod pool;
mod self_test;
mod upload;

pub use adapter::{AdapterChoice, AdapterDescription, GpuOptions, adapters};
pub use context::{Gpu, PassBuffer};
pub(crate) use forward::Tape;
