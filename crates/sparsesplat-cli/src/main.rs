//! The `sparsesplat` command.
fn main() {}
