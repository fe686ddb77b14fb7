//! The public interface of refine.

#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

mod hard_cases;
mod refinement;
mod scenes;
