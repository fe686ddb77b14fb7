//! `case` makes inputs, `oracle` computes the formulas pair by pair; `properties` compares, `gradients` takes central
//! differences, `golden` has the numbers of another implementation, `hostile` bad inputs, `files` sound and damaged files;
//! `fused` has the same of the fused form.

#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

mod case;
mod files;
mod fused;
mod golden;
#[cfg(feature = "candle")]
mod gradients;
mod hostile;
mod oracle;
mod properties;
