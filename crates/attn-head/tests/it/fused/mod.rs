//! The fused form.

mod cases;
mod forward;
mod gradient;
mod op;
