//! - `golden`: entropies found by another program
//! - `properties`: entropy and samples on random input, against definitions
//! - `sampling`: single cases of budgets and samplers

mod golden;
mod properties;
mod sampling;
