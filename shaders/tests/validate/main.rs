//! What can be known of the shaders without a GPU. Each module says what belongs there.

mod abi;
mod gate;
mod headers;
mod strides;
mod table;
