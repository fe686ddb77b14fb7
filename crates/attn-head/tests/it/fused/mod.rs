//! The fused form.

mod cases;
mod forward;
mod gradient;
#[cfg(feature = "candle")]
mod op;
#[cfg(feature = "candle")]
mod plain;
