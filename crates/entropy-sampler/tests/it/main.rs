//! - `golden`: entropies found by another program
//! - `marginals`: how often pixels are chosen, over 10,000 draws
//! - `order`: beginnings of the progressive order
//! - `per_view`: a budget for each view
//! - `properties`: entropy and samples on random input, against definitions
//! - `sampling`: single cases of budgets and samplers
//! - `spread`: how far chosen pixels lie apart

mod golden;
mod marginals;
mod order;
mod per_view;
mod properties;
mod sampling;
mod spread;
