//! Golden cases, properties against the f64 reference, and hostile input.

mod activated;
mod backward;
mod check;
mod ellipsoids;
mod fixtures;
mod golden;
#[cfg(feature = "gpu")]
mod gpu;
mod gradients;
mod hard_case;
mod hard_cases;
mod hostile;
mod losses;
#[cfg(feature = "gpu")]
mod parity;
mod properties;
mod scenes;
