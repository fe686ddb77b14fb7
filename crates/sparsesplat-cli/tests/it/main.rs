//! The binary as a user calls it.

mod hostile;
mod jobs;
mod tiny;
