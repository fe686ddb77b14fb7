//! Golden cases, properties against the f64 reference, and hostile input.

mod check;
mod fixtures;
mod golden;
mod gradients;
mod hostile;
mod losses;
mod properties;
mod scenes;
