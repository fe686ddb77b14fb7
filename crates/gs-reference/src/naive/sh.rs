//! Spherical harmonics in f64.

use glam::DVec3;

/// The real spherical harmonics of degree 0 to 3 with the Condon–Shortley sign, m = -l..l, at a unit direction; sixteen
/// numbers of which a lower degree uses the first (degree + 1)².
#[must_use]
pub fn basis(direction: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let c1 = 0.4886025119029199;
    [
        0.28209479177387814,
        -c1 * y,
        c1 * z,
        -c1 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ]
}

/// The derivatives of [`basis`], taken as polynomials of three independent numbers, by the direction. Only their part
/// across the direction means anything.
pub(super) fn basis_gradients(direction: DVec3) -> [DVec3; 16] {
    let DVec3 { x, y, z } = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let c1 = 0.4886025119029199;
    [
        DVec3::ZERO,
        DVec3::new(0.0, -c1, 0.0),
        DVec3::new(0.0, 0.0, c1),
        DVec3::new(-c1, 0.0, 0.0),
        1.0925484305920792 * DVec3::new(y, x, 0.0),
        -1.0925484305920792 * DVec3::new(0.0, z, y),
        0.31539156525252005 * DVec3::new(-2.0 * x, -2.0 * y, 4.0 * z),
        -1.0925484305920792 * DVec3::new(z, 0.0, x),
        0.5462742152960396 * DVec3::new(2.0 * x, -2.0 * y, 0.0),
        -0.5900435899266435 * DVec3::new(6.0 * x * y, 3.0 * (xx - yy), 0.0),
        2.890611442640554 * DVec3::new(y * z, x * z, x * y),
        -0.4570457994644658 * DVec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        0.3731763325901154 * DVec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * (xx + yy)),
        -0.4570457994644658 * DVec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        1.445305721320277 * DVec3::new(2.0 * x * z, -2.0 * y * z, xx - yy),
        -0.5900435899266435 * DVec3::new(3.0 * (xx - yy), -6.0 * x * y, 0.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tolerance::{QUADRATURE, ROUNDING_F64};
    use std::f64::consts::PI;

    #[test]
    fn the_basis_is_orthonormal_on_the_sphere() {
        // Sixteen sectors are exact for these polynomials; the midpoint rule along z needs many rings.
        let (rings, sectors) = (4000, 16);
        let mut gram = [[0.0; 16]; 16];
        for ring in 0..rings {
            let z = -1.0 + (f64::from(ring) + 0.5) * 2.0 / f64::from(rings);
            let radius = (1.0 - z * z).sqrt();
            for sector in 0..sectors {
                let angle = f64::from(sector) * 2.0 * PI / f64::from(sectors);
                let y = basis(DVec3::new(radius * angle.cos(), radius * angle.sin(), z));
                for (row, a) in gram.iter_mut().zip(y) {
                    for (entry, b) in row.iter_mut().zip(y) {
                        *entry += a * b * 4.0 * PI / f64::from(rings * sectors);
                    }
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((entry - expected).abs() < QUADRATURE, "<Y{i}, Y{j}> = {entry}");
            }
        }
    }

    #[test]
    fn the_signs_are_those_of_the_ply() {
        let c1 = (3.0 / (4.0 * PI)).sqrt();
        for (direction, expected) in
            [(DVec3::Y, [-c1, 0.0, 0.0]), (DVec3::Z, [0.0, c1, 0.0]), (DVec3::X, [0.0, 0.0, -c1])]
        {
            for (found, expected) in basis(direction)[1..4].iter().zip(expected) {
                assert!((found - expected).abs() < ROUNDING_F64);
            }
        }
    }
}
