//! Input and output of the backward pass.

use crate::{Error, RenderSettings, Result};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians};
use rayon::prelude::*;

/// Derivatives of a loss with respect to the pixels of one [`Rendering`](crate::Rendering).
#[derive(Debug, Clone, PartialEq)]
pub struct PixelGradients {
    /// By the colours, `[height, width, 3]`.
    pub image: Vec<f32>,
    /// By the opacity, `[height, width]`; none is zero everywhere.
    pub alpha: Option<Vec<f32>>,
    /// By the expected depth, `[height, width]`, 1 / scene units; none is zero everywhere. Only for views rendered with
    /// [`RenderSettings::depth`]. Pixels in which nothing is drawn have no depth: theirs is ignored.
    pub depth: Option<Vec<f32>>,
}

impl PixelGradients {
    /// Whether lengths fit the view, and every number is finite.
    pub(crate) fn check(&self, camera: &Camera, settings: &RenderSettings) -> Result<()> {
        let pixels = camera.width() * camera.height();
        if self.depth.is_some() && !settings.depth {
            return Err(Error::DepthNotRendered);
        }
        let planes = [
            ("image", Some(&self.image), pixels * 3),
            ("alpha", self.alpha.as_ref(), pixels),
            ("depth", self.depth.as_ref(), pixels),
        ];
        for (what, plane, expected) in planes {
            let Some(plane) = plane else { continue };
            if plane.len() != expected {
                return Err(Error::PixelGradientLength { what, expected, found: plane.len() });
            }
            if let Some(index) = plane.iter().position(|value| !value.is_finite()) {
                return Err(Error::PixelGradientNotFinite { what, index });
            }
        }
        Ok(())
    }
}

/// Derivatives of a loss, summed over the views of a batch. Gaussians that are in no picture, culled or left out have
/// exactly zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients {
    /// By the stored geometry, `[N, 11]`, in the columns of [`Gaussians`]: with respect to the raw quaternion, the
    /// logarithms of the scales and the logit of the opacity.
    pub geometry: Vec<f32>,
    /// By the SH coefficients, `[N, (degree+1)², 3]`.
    pub sh: Vec<f32>,
    /// By the background colour.
    pub background: [f64; 3],
    /// By the pose of each view.
    pub poses: Vec<PoseGradient>,
}

impl Gradients {
    /// No gradient yet.
    pub(crate) fn zero(gaussians: &Gaussians) -> Self {
        Self {
            geometry: zeros(gaussians.geometry().len()),
            sh: zeros(gaussians.sh().len()),
            background: [0.0; 3],
            poses: Vec::new(),
        }
    }
}

/// Zeros in memory that is there. Fresh memory is one page of zeros shown many times: to read a number and write it back
/// would have the system make room for each page twice, and stop all threads every time.
fn zeros(n: usize) -> Vec<f32> {
    let mut zeros = vec![0.0; n];
    zeros.par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
    zeros
}

/// Derivatives of a loss with respect to a world-to-camera pose `p_camera = R p_world + t`, its twelve numbers taken as
/// independent. The camera centre, from which SH colours are seen, is -Rᵀ t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseGradient {
    /// By the entries of R.
    pub rotation: DMat3,
    /// By t, 1 / scene units.
    pub translation: DVec3,
}

impl PoseGradient {
    /// The derivative on the manifold of poses: by (ρ, θ) of `T ← exp(ξ^) T`, ρ in camera axes and scene units, θ in
    /// radians, at the pose of `camera`.
    #[must_use]
    pub fn twist(&self, camera: &Camera) -> [f64; 6] {
        let (r, g) = (camera.rotation(), self.rotation);
        let turn = r.x_axis.cross(g.x_axis)
            + r.y_axis.cross(g.y_axis)
            + r.z_axis.cross(g.z_axis)
            + camera.translation().cross(self.translation);
        let shift = self.translation;
        [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]
    }
}
