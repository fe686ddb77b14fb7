//! Spherical harmonics in a camera's axes to the world's.
//!
//! A harmonic of degree 1 is a vector v, its value in a unit direction d is v·d; one of degree 2 is a symmetric matrix
//! M without trace, its value d·Md. Seen from a frame with d' = R d these are Rᵀv and RᵀMR: to rotate coefficients, each
//! basis function is rotated and taken apart again.

use glam::{DMat3, DVec3};

/// The basis of degree 1, in the order and with the signs of the 3DGS layout, up to a common factor.
const VECTORS: [DVec3; 3] = [DVec3::NEG_Y, DVec3::Z, DVec3::NEG_X];

/// The basis of degree 2 as symmetric matrices, likewise; the common factor is that of xy.
fn matrices() -> [DMat3; 5] {
    let symmetric = |xx: f64, yy: f64, zz: f64, xy: f64, yz: f64, xz: f64| {
        DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz))
    };
    // Of 1.0925 xy, -1.0925 yz, 0.3154 (2zz - xx - yy), -1.0925 xz, 0.5463 (xx - yy).
    let third = 1.0 / 12f64.sqrt();
    [
        symmetric(0.0, 0.0, 0.0, 0.5, 0.0, 0.0),
        symmetric(0.0, 0.0, 0.0, 0.0, -0.5, 0.0),
        symmetric(-third, -third, 2.0 * third, 0.0, 0.0, 0.0),
        symmetric(0.0, 0.0, 0.0, 0.0, 0.0, -0.5),
        symmetric(0.5, -0.5, 0.0, 0.0, 0.0, 0.0),
    ]
}

fn dot(a: &DMat3, b: &DMat3) -> f64 {
    a.to_cols_array().iter().zip(b.to_cols_array()).map(|(a, b)| a * b).sum()
}

/// Linear maps that take coefficients of degrees 1 and 2 from a camera's axes to the world's.
#[derive(Debug, Clone, Copy)]
pub(super) struct RotateSh {
    first: [[f32; 3]; 3],
    second: [[f32; 5]; 5],
}

impl RotateSh {
    /// For a camera with this world-to-camera rotation.
    pub(super) fn new(rotation: DMat3) -> Self {
        let basis = matrices();
        let first = |n: usize, m: usize| VECTORS[n].dot(rotation.transpose() * VECTORS[m]) as f32;
        let turned = basis.map(|matrix| rotation.transpose() * matrix * rotation);
        let second = |n: usize, m: usize| (dot(&turned[m], &basis[n]) / dot(&basis[n], &basis[n])) as f32;
        Self {
            first: std::array::from_fn(|n| std::array::from_fn(|m| first(n, m))),
            second: std::array::from_fn(|n| std::array::from_fn(|m| second(n, m))),
        }
    }

    /// Coefficients `[8][rgb]` of degrees 1 and 2 in the world's axes from those in the camera's.
    pub(super) fn turn(&self, camera: &[[f32; 3]], world: &mut [[f32; 3]]) {
        apply(&self.first, false, &camera[..3], &mut world[..3]);
        apply(&self.second, false, &camera[3..], &mut world[3..]);
    }

    /// The derivative of [`RotateSh::turn`]: the transposed maps.
    pub(super) fn backward(&self, world: &[[f32; 3]], camera: &mut [[f32; 3]]) {
        apply(&self.first, true, &world[..3], &mut camera[..3]);
        apply(&self.second, true, &world[3..], &mut camera[3..]);
    }
}

fn apply<const N: usize>(map: &[[f32; N]; N], transposed: bool, from: &[[f32; 3]], to: &mut [[f32; 3]]) {
    for n in 0..N {
        to[n] = std::array::from_fn(|channel| {
            (0..N).map(|m| if transposed { map[m][n] } else { map[n][m] } * from[m][channel]).sum()
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::basis;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1.0f64..1.0)
            .prop_map(DVec3::from)
            .prop_filter("a direction", |d| d.length() > 0.1)
            .prop_map(DVec3::normalize)
    }

    proptest! {
        #[test]
        fn colours_are_those_of_the_turned_direction(
            axis in direction(), angle in -3.0f64..3.0, d in direction(),
            values in prop::array::uniform8(-1.0f32..1.0),
        ) {
            let rotation = DMat3::from_axis_angle(axis, angle);
            let rotate = RotateSh::new(rotation);
            let mut world = [[0.0; 3]; 8];
            rotate.turn(&values.map(|v| [v, -v, 0.5 * v]), &mut world);
            let value = |coefficients: &mut dyn Iterator<Item = f32>, d: DVec3| -> f64 {
                coefficients.zip(&basis(d)[1..]).map(|(c, b)| f64::from(c) * b).sum()
            };
            let expected = value(&mut values.into_iter(), rotation * d);
            prop_assert!((value(&mut world.iter().map(|c| c[0]), d) - expected).abs() < 1e-5);
            prop_assert!((value(&mut world.iter().map(|c| c[1]), d) + expected).abs() < 1e-5);
        }

        #[test]
        fn backward_is_the_transposed_map(
            axis in direction(), angle in -3.0f64..3.0,
            a in prop::array::uniform8(-1.0f32..1.0), b in prop::array::uniform8(-1.0f32..1.0),
        ) {
            let rotate = RotateSh::new(DMat3::from_axis_angle(axis, angle));
            let (a, b) = (a.map(|v| [v; 3]), b.map(|v| [v; 3]));
            let (mut forward, mut backward) = ([[0.0; 3]; 8], [[0.0; 3]; 8]);
            rotate.turn(&a, &mut forward);
            rotate.backward(&b, &mut backward);
            let product = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f32 {
                a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
            };
            prop_assert!((product(&forward, &b) - product(&a, &backward)).abs() < 1e-4);
        }
    }
}
