//! What a check of a data set finds.

#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

mod check;
