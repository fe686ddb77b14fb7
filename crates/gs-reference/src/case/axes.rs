//! Cases whose spherical harmonics have other axes.

use super::Case;
use crate::{ShAxes, Variable};
use glam::{DMat3, DQuat};
use gs_scene::{Camera, Gaussians};

impl Case {
    /// The same picture for renderers that know the standard SH axes only: scene, camera and gradients in a world whose
    /// (x, y, z) are the old (z, x, y), if the case has other axes. Turned quaternions are rounded to f32, so the
    /// f64 reference is to be judged on the case as it was read.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "the order of its axes does not make a camera invalid")]
    pub fn in_standard_axes(mut self) -> Self {
        if self.profile.sh_axes == ShAxes::Standard {
            return self;
        }
        self.profile.sh_axes = ShAxes::Standard;
        for row in self.gaussians.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY) {
            row[gs_scene::MEAN].rotate_right(1);
            let quaternion: Vec<f64> = row[gs_scene::QUATERNION].iter().map(|&q| f64::from(q)).collect();
            for (stored, turned) in row[gs_scene::QUATERNION].iter_mut().zip(turned(&quaternion)) {
                *stored = turned as f32;
            }
        }
        let rotation = self.camera.rotation();
        let rotation = DMat3::from_cols(rotation.z_axis, rotation.x_axis, rotation.y_axis);
        self.camera = Camera::new(*self.camera.intrinsics(), rotation, self.camera.translation())
            .expect("axes in another order are as valid");
        for gradient in self.losses.iter_mut().flat_map(|loss| &mut loss.gradients) {
            match gradient.variable {
                Variable::Means => gradient.values.chunks_exact_mut(3).for_each(|by| by.rotate_right(1)),
                Variable::WorldToCamera => {
                    gradient.values.chunks_exact_mut(4).for_each(|row| row[..3].rotate_right(1));
                }
                Variable::Quaternions => {
                    gradient.values.chunks_exact_mut(4).for_each(|by| by.copy_from_slice(&turned(by)));
                }
                _ => {}
            }
        }
        self
    }
}

/// A quaternion (w, x, y, z), or a gradient by one, in the world of cycled axes. Multiplication by a unit quaternion is
/// orthogonal, so it turns both alike.
fn turned(quaternion: &[f64]) -> [f64; 4] {
    let q = DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5)
        * DQuat::from_xyzw(quaternion[1], quaternion[2], quaternion[3], quaternion[0]);
    [q.w, q.x, q.y, q.z]
}
