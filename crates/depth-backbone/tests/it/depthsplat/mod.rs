/// Golden files of another implementation.
mod golden;
/// Input that is wrong, empty or extreme.
mod hostile;
/// Maps and depth equal those of the golden files.
mod parity;
