//! - `properties`: equal to the oracle on random sets of every awkward shape
//! - `hostile`: values on the edge of the format, degenerate sizes, bad input
//! - `golden`: sets whose neighbours were found by another program

mod golden;
mod hostile;
mod properties;
mod sets;
