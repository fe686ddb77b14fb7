//! Changes of axes. PLY, compressed PLY and .splat have the axes of the data (x right, y down, z forward, as cameras have
//! them); SPZ has y up and z backward, glTF x left and y up.

use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, QUATERNION, sh_coefficients};

/// The real spherical harmonics of degree 0 to 3 with the Condon-Shortley sign at a direction of length 1, as the 3DGS PLY
/// stores them.
fn basis(d: DVec3) -> [f64; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_791_773_878_1,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079 * x * y,
        -1.092_548_430_592_079 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_7 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_7 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
}

/// Other signs of the axes. Every number of a Gaussian changes at most its sign, so nothing is rounded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Flip {
    axes: [f32; 3],
    sh: [f32; 16],
}

impl Flip {
    /// From signs of the three axes, each 1 or -1. A flip is its own inverse.
    pub(crate) fn new(axes: [f32; 3]) -> Self {
        // In each axis a basis function is even or odd; no function is 0 in this direction.
        let direction = DVec3::new(0.36, 0.48, 0.8);
        let flipped = basis(direction * DVec3::from(axes.map(f64::from)));
        let plain = basis(direction);
        Self { axes, sh: std::array::from_fn(|i| if plain[i] * flipped[i] < 0.0 { -1.0 } else { 1.0 }) }
    }

    /// PLY's axes to those of SPZ (right, up, backward), and back.
    pub(crate) fn spz() -> Self {
        Self::new([1.0, -1.0, -1.0])
    }

    /// PLY's axes to those of glTF (left, up, forward), and back.
    pub(crate) fn gltf() -> Self {
        Self::new([-1.0, -1.0, 1.0])
    }

    pub(crate) fn mean(&self, mean: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| self.axes[i] * mean[i])
    }

    /// With F the flip and R the rotation, F R F: the same ellipsoid in the other axes, whose axes may point the other way.
    pub(crate) fn quaternion<T: From<f32> + std::ops::Mul<Output = T> + Copy>(&self, q: [T; 4]) -> [T; 4] {
        let [x, y, z] = self.axes;
        [q[0], T::from(y * z) * q[1], T::from(x * z) * q[2], T::from(x * y) * q[3]]
    }

    /// The sign of an SH coefficient.
    pub(crate) fn sh(&self, coefficient: usize) -> f32 {
        self.sh[coefficient]
    }

    /// All Gaussians in the other axes.
    pub(crate) fn apply(&self, gaussians: &mut Gaussians) {
        let width = sh_coefficients(gaussians.sh_degree()) * 3;
        let (geometry, sh) = gaussians.buffers_mut();
        for row in geometry.chunks_exact_mut(Gaussians::GEOMETRY) {
            let mean = self.mean(std::array::from_fn(|i| row[MEAN.start + i]));
            row[MEAN].copy_from_slice(&mean);
            let quaternion: [f32; 4] = std::array::from_fn(|i| row[QUATERNION.start + i]);
            row[QUATERNION].copy_from_slice(&self.quaternion(quaternion));
        }
        for row in sh.chunks_exact_mut(width) {
            for (coefficient, rgb) in row.chunks_exact_mut(3).enumerate() {
                rgb.iter_mut().for_each(|value| *value *= self.sh(coefficient));
            }
        }
    }
}

/// An axis to turn a scene about by 180 degrees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HalfTurn {
    /// Keeps x: PLY's axes and SPZ's.
    X,
    /// Keeps y.
    Y,
    /// Keeps z: PLY's axes and glTF's.
    Z,
}

/// Turns a scene by 180 degrees about an axis through the origin, without rounding.
///
/// Files that were written in other axes than their format has become upright by it.
pub fn half_turn(gaussians: &mut Gaussians, axis: HalfTurn) {
    let axes = match axis {
        HalfTurn::X => [1.0, -1.0, -1.0],
        HalfTurn::Y => [-1.0, 1.0, -1.0],
        HalfTurn::Z => [-1.0, -1.0, 1.0],
    };
    Flip::new(axes).apply(gaussians);
}

/// A rotation, a scale and a translation, in this order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Of unit length.
    pub rotation: DQuat,
    /// Above 0.
    pub scale: f64,
    /// In units after scaling.
    pub translation: DVec3,
}

impl Similarity {
    /// Moves all Gaussians, and turns their colours with them.
    pub fn apply(&self, gaussians: &mut Gaussians) {
        let count = sh_coefficients(gaussians.sh_degree());
        let (geometry, sh) = gaussians.buffers_mut();
        for row in geometry.chunks_exact_mut(Gaussians::GEOMETRY) {
            let mean = DVec3::from(std::array::from_fn(|i| f64::from(row[MEAN.start + i])));
            let mean = self.translation + self.scale * (self.rotation * mean);
            row[MEAN].copy_from_slice(&mean.to_array().map(|value| value as f32));
            let [w, x, y, z] = std::array::from_fn(|i| f64::from(row[QUATERNION.start + i]));
            let q = self.rotation * DQuat::from_xyzw(x, y, z, w);
            row[QUATERNION].copy_from_slice(&[q.w, q.x, q.y, q.z].map(|value| value as f32));
            row[LOG_SCALE].iter_mut().for_each(|value| *value = (f64::from(*value) + self.scale.ln()) as f32);
        }
        let rotation = sh_rotation(DMat3::from_quat(self.rotation));
        for row in sh.chunks_exact_mut(count * 3) {
            let old: Vec<f64> = row.iter().map(|&value| value.into()).collect();
            for (i, rgb) in row.chunks_exact_mut(3).enumerate() {
                for (channel, value) in rgb.iter_mut().enumerate() {
                    let turned = (0..count).map(|j| rotation[i][j] * old[3 * j + channel]);
                    *value = turned.sum::<f64>() as f32;
                }
            }
        }
    }
}

/// The matrix that turns SH coefficients as a rotation turns directions: with it, the colour in the direction R d is what it was in
/// the direction d. Its entry (i, j) is the integral of Yᵢ(R d) Yⱼ(d) over the sphere.
fn sh_rotation(rotation: DMat3) -> [[f64; 16]; 16] {
    // Gauss-Legendre in z times equal steps of the azimuth: exact up to degree 7, and the product has degree 6.
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (-0.339_981_043_584_856_26, 0.652_145_154_862_546_2),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_2),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    ];
    const STEPS: u32 = 8;
    let mut matrix = [[0.0; 16]; 16];
    for (z, weight) in NODES {
        for step in 0..STEPS {
            let azimuth = std::f64::consts::TAU * f64::from(step) / f64::from(STEPS);
            let radius = (1.0 - z * z).sqrt();
            let direction = DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
            let (turned, plain) = (basis(rotation * direction), basis(direction));
            let weight = weight * std::f64::consts::TAU / f64::from(STEPS);
            for (row, a) in matrix.iter_mut().zip(turned) {
                for (entry, b) in row.iter_mut().zip(plain) {
                    *entry += weight * a * b;
                }
            }
        }
    }
    // Degrees do not mix.
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            if i.isqrt() != j.isqrt() {
                *entry = 0.0;
            }
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Gaussians {
        let mut scene = Gaussians::empty(3).unwrap();
        let sh: Vec<f32> = (0..48).map(|i| ((i * 37 % 23) as f32 - 11.0) * 0.03).collect();
        scene.push([1.0, -2.0, 0.5], [0.5, -0.1, 0.7, 0.3], [-1.0, -2.0, -3.0], 0.4, &sh);
        scene
    }

    /// The covariance of the first Gaussian, and its colour in a direction.
    fn seen(scene: &Gaussians, direction: DVec3) -> (DVec3, DMat3, DVec3) {
        let g = scene.geometry();
        let value = |i: usize| f64::from(g[i]);
        let q = DQuat::from_xyzw(value(4), value(5), value(6), value(3)).normalize();
        let m = DMat3::from_quat(q)
            * DMat3::from_diagonal(DVec3::new(value(7).exp(), value(8).exp(), value(9).exp()));
        let basis = basis(direction);
        let colour = |c: usize| (0..16).map(|k| basis[k] * f64::from(scene.sh()[3 * k + c])).sum::<f64>();
        (
            DVec3::new(value(0), value(1), value(2)),
            m * m.transpose(),
            DVec3::from(std::array::from_fn(colour)),
        )
    }

    fn assert_turned(before: &Gaussians, after: &Gaussians, turn: DMat3, scale: f64, shift: DVec3) {
        let direction = DVec3::new(0.2, -0.7, 0.4).normalize();
        let (mean, covariance, colour) = seen(before, direction);
        let (new_mean, new_covariance, new_colour) = seen(after, turn * direction);
        assert!((turn * mean * scale + shift - new_mean).length() < 1e-6);
        let moved = turn * covariance * turn.transpose() * (scale * scale);
        assert!((moved - new_covariance).to_cols_array().iter().all(|value| value.abs() < 1e-6 * scale));
        assert!((colour - new_colour).length() < 1e-6, "{colour} {new_colour}");
    }

    #[test]
    fn a_half_turn_moves_ellipsoids_and_colours_and_twice_nothing() {
        for (axis, turn) in [
            (HalfTurn::X, DVec3::new(1.0, -1.0, -1.0)),
            (HalfTurn::Y, DVec3::new(-1.0, 1.0, -1.0)),
            (HalfTurn::Z, DVec3::new(-1.0, -1.0, 1.0)),
        ] {
            let mut turned = scene();
            half_turn(&mut turned, axis);
            assert_turned(&scene(), &turned, DMat3::from_diagonal(turn), 1.0, DVec3::ZERO);
            half_turn(&mut turned, axis);
            assert_eq!(turned, scene());
        }
        // A mirrored system of axes, too.
        let mut turned = scene();
        Flip::new([1.0, 1.0, -1.0]).apply(&mut turned);
        assert_turned(&scene(), &turned, DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)), 1.0, DVec3::ZERO);
    }

    #[test]
    fn a_similarity_moves_ellipsoids_and_colours() {
        let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 1.1);
        let (scale, translation) = (2.5, DVec3::new(3.0, -1.0, 7.0));
        let mut turned = scene();
        Similarity { rotation, scale, translation }.apply(&mut turned);
        assert_turned(&scene(), &turned, DMat3::from_quat(rotation), scale, translation);
    }
}
