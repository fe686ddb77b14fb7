//! Golden cases, properties against the f64 reference, and hostile input.

mod check;
mod golden;
mod gradients;
mod hostile;
mod properties;
mod scenes;
