//! The reference against golden data, and against central differences of itself; hostile input and files that are no
//! golden data; the twins of the shader passes against the reference.

mod differences;
mod files;
mod golden;
mod hostile;
mod twins;
