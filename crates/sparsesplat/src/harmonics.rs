//! Real spherical harmonics.

use glam::DVec3;
use gs_scene::sh_coefficients;

/// The degree of what heads and exposure make.
pub(crate) const DEGREE: usize = 2;
/// Coefficients up to that degree.
pub(crate) const TERMS: usize = sh_coefficients(DEGREE);

/// The basis in a unit direction, in the order and with the signs of the 3DGS layout.
pub(crate) fn basis(DVec3 { x, y, z }: DVec3) -> [f64; TERMS] {
    const C0: f64 = 0.282_094_791_773_878_14;
    const C1: f64 = 0.488_602_511_902_919_9;
    const C2: f64 = 1.092_548_430_592_079_2;
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2 * x * y,
        -C2 * y * z,
        C2 / 12f64.sqrt() * (2.0 * z * z - x * x - y * y),
        -C2 * x * z,
        0.5 * C2 * (x * x - y * y),
    ]
}
