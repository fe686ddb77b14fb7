//! Binary glTF 2.0 with the extension `KHR_gaussian_splatting`: each quantity is an attribute of a primitive of points.
//!
//! Sizes and opacities are stored activated, rotations of length 1 as (x, y, z, w). glTF's axes: x left, y up, z forward.

mod accessor;
mod json;
mod read;
mod write;

pub(crate) use read::decode;
pub(crate) use write::{encode, losses};

const MAGIC: [u8; 4] = *b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BINARY_CHUNK: u32 = 0x004E_4942;
const EXTENSION: &str = "KHR_gaussian_splatting";

/// Component type of f32.
const FLOAT: u32 = 5126;
/// Component type of bytes from 0 to 255.
const UNSIGNED_BYTE: u32 = 5121;

/// Name of the attribute of an SH coefficient, counted over all degrees.
fn sh_attribute(coefficient: usize) -> String {
    let degree = coefficient.isqrt();
    format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{}", coefficient - degree * degree)
}

fn attribute(name: &str) -> String {
    format!("{EXTENSION}:{name}")
}
