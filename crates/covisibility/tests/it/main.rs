//! - `idea`: scenes by hand that show what the neighbours are for
//! - `properties`: equal to the oracle on random anchors and awkward cameras
//! - `hostile`: values on the edge of the format, degenerate sizes, bad input

// clippy.toml allows it in test functions; these helpers serve nothing else.
#![allow(clippy::unwrap_used)]

mod hostile;
mod idea;
mod properties;
mod sets;
