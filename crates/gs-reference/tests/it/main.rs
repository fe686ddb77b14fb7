//! The reference against golden data, and against central differences of itself; hostile input and files that are no
//! golden data.

mod differences;
mod files;
mod golden;
mod hostile;
mod twins;
