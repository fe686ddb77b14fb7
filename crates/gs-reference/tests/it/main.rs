//! The reference against golden data, and against central differences of itself; files that are no golden data.

mod golden;
