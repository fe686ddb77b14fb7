//! The binary as a user calls it.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking, as tests do")]

mod benches;
mod data;
mod devices;
mod hostile;
mod jobs;
mod tiny;
mod training;
