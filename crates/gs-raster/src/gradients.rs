//! Input and output of the backward pass.

use crate::activated::{CHUNK, inside};
use crate::cpu::Sums;
use crate::{Activated, Colors, Error, RenderSettings, Result};
use cpu_kernels::{Isa, compiled_for};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0, sh_coefficients};
use rayon::prelude::*;
use std::borrow::Cow;

/// Derivatives of a loss with respect to the pixels of one [`Rendering`](crate::Rendering).
#[derive(Debug, Clone, PartialEq)]
pub struct PixelGradients<'a> {
    /// By the colours, `[height, width, 3]`; borrowed or not.
    pub image: Cow<'a, [f32]>,
    /// By the opacity, `[height, width]`; none is zero everywhere.
    pub alpha: Option<Vec<f32>>,
    /// By the expected depth, `[height, width]`, 1 / scene units; none is zero everywhere. Only for views rendered with
    /// [`RenderSettings::depth`]. Pixels in which nothing is drawn have no depth: theirs is ignored.
    pub depth: Option<Vec<f32>>,
}

impl PixelGradients<'_> {
    /// Whether lengths fit the view, and every number is finite.
    pub(crate) fn check(&self, camera: &Camera, settings: &RenderSettings) -> Result<()> {
        let pixels = camera.width() * camera.height();
        if self.depth.is_some() && !settings.depth {
            return Err(Error::DepthNotRendered);
        }
        let planes = [
            ("image", Some(&*self.image), pixels * 3),
            ("alpha", self.alpha.as_deref(), pixels),
            ("depth", self.depth.as_deref(), pixels),
        ];
        for (what, plane, expected) in planes {
            let Some(plane) = plane else { continue };
            if plane.len() != expected {
                return Err(Error::PixelGradientLength { what, expected, found: plane.len() });
            }
            if !largest_magnitude(plane).is_finite() {
                let index = plane.iter().position(|value| !value.is_finite()).unwrap_or_default();
                return Err(Error::PixelGradientNotFinite { what, index });
            }
        }
        Ok(())
    }
}

/// The largest of the magnitudes; NaN counts as larger than infinity, and is the result if there is one. By the bits that hold exponent and
/// fraction, whose maximum is one of integers: no chain of comparisons of floats.
pub(crate) fn largest_magnitude(numbers: &[f32]) -> f32 {
    let isa = Isa::in_use();
    let of_chunk = |chunk: &[f32]| -> i32 {
        compiled_for!(isa, {
            chunk.iter().fold(0, |largest, number| largest.max(number.abs().to_bits() as i32))
        })
    };
    let largest = numbers.par_chunks(1 << 15).map(of_chunk).reduce(|| 0, i32::max);
    f32::from_bits(largest.cast_unsigned())
}

/// Derivatives of a loss, summed over the views of a batch. Gaussians that are in no picture, culled or left out have
/// exactly zero.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gradients {
    /// By the stored geometry, `[N, 11]`, in the columns of [`Gaussians`]: with respect to the raw quaternion, the
    /// logarithms of the scales and the logit of the opacity.
    pub geometry: Vec<f32>,
    /// By the SH coefficients, `[N, (degree+1)², 3]`.
    pub sh: Vec<f32>,
    /// By the background colour.
    pub background: [f64; 3],
    /// By the camera of each view.
    pub cameras: Vec<CameraGradient>,
}

/// [`Gradients`] in the shapes of the arrays of [`Activated`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ActivatedGradients {
    /// `[N, 3]`, 1 / scene units.
    pub means: Vec<f32>,
    /// `[N, 4]`.
    pub quats: Vec<f32>,
    /// `[N, 3]`, 1 / scene units.
    pub scales: Vec<f32>,
    /// `[N]`.
    pub opacities: Vec<f32>,
    /// In the shape of [`Activated::colors`]; 0 for coefficients that are not used.
    pub colors: Vec<f32>,
    /// By the background colour.
    pub background: [f64; 3],
    /// By the camera of each view.
    pub cameras: Vec<CameraGradient>,
}

impl Gradients {
    /// No gradient yet, in the memory of what was here.
    pub(crate) fn clear(&mut self, n: usize, sh_degree: usize) {
        let Self { geometry, sh, background, cameras } = self;
        clear(geometry, n * Gaussians::GEOMETRY);
        clear(sh, n * sh_coefficients(sh_degree) * 3);
        *background = [0.0; 3];
        cameras.clear();
    }

    /// Where the CPU adds the gradients by Gaussians.
    pub(crate) fn sums(&mut self) -> Sums<'_> {
        Sums::Stored { geometry: &mut self.geometry, sh: &mut self.sh }
    }

    /// The chain rule: gradients by activated Gaussians, of the gradients by what is stored of them.
    ///
    /// # Panics
    /// If these are not gradients of as many Gaussians of the same SH degree.
    #[must_use]
    pub fn activated(self, gaussians: &Activated<'_>) -> ActivatedGradients {
        let mut found = ActivatedGradients::default();
        found.clear(gaussians);
        let (n, kind) = (gaussians.len(), gaussians.kind);
        let (row, used) = (kind.row(), sh_coefficients(kind.degree()) * 3);
        let expected = (n * Gaussians::GEOMETRY, n * used);
        assert_eq!((self.geometry.len(), self.sh.len()), expected, "gradients of other Gaussians");
        for (index, gradients) in self.geometry.chunks_exact(Gaussians::GEOMETRY).enumerate() {
            found.means[3 * index..][..3].copy_from_slice(&gradients[MEAN]);
            found.quats[4 * index..][..4].copy_from_slice(&gradients[QUATERNION]);
            found.scales[3 * index..][..3].copy_from_slice(&gradients[LOG_SCALE]);
            found.opacities[index] = gradients[OPACITY_LOGIT];
        }
        for (colors, sh) in found.colors.chunks_exact_mut(row).zip(self.sh.chunks_exact(used)) {
            colors[..used].copy_from_slice(sh);
        }
        found.chain(gaussians);
        found.chain_colors(kind);
        ActivatedGradients { background: self.background, cameras: self.cameras, ..found }
    }
}

impl ActivatedGradients {
    /// No gradient yet, in the memory of what was here.
    pub(crate) fn clear(&mut self, gaussians: &Activated<'_>) {
        let n = gaussians.len();
        let Self { means, quats, scales, opacities, colors, background, cameras } = self;
        clear(means, 3 * n);
        clear(quats, 4 * n);
        clear(scales, 3 * n);
        clear(opacities, n);
        clear(colors, gaussians.kind.row() * n);
        *background = [0.0; 3];
        cameras.clear();
    }

    /// Where the CPU adds the gradients by Gaussians, before [`ActivatedGradients::chain_colors`].
    pub(crate) fn sums(&mut self, kind: Colors) -> Sums<'_> {
        let Self { means, quats, scales, opacities, colors, .. } = self;
        Sums::Activated { means, quats, scales, opacities, colors, color_row: kind.row() }
    }

    /// The chain rule for scales and opacities, in place. With a loss L: ∂L/∂scale = ∂L/∂(ln scale) / scale,
    /// ∂L/∂opacity = ∂L/∂logit / (o (1 - o)).
    fn chain(&mut self, gaussians: &Activated<'_>) {
        let isa = Isa::in_use();
        let scales = self.scales.par_chunks_mut(CHUNK * 3).zip(gaussians.scales.par_chunks(CHUNK * 3));
        let opacities = self.opacities.par_chunks_mut(CHUNK).zip(gaussians.opacities.par_chunks(CHUNK));
        scales.zip(opacities).for_each(|(scales, opacities)| compiled_for!(isa, chain(scales, opacities)));
    }

    /// The chain rule for colours, in place: ∂L/∂rgb = ∂L/∂dc / Y₀.
    pub(crate) fn chain_colors(&mut self, kind: Colors) {
        if kind == Colors::Rgb {
            self.colors.par_chunks_mut(CHUNK * 3).for_each(|chunk| {
                for gradient in chunk {
                    *gradient = finite(f64::from(*gradient) / f64::from(SH_C0));
                }
            });
        }
    }
}

/// The chain rule for pairs of gradients and numbers, which is a loop without branches.
#[inline(always)]
fn chain((by_scales, scales): (&mut [f32], &[f32]), (by_opacities, opacities): (&mut [f32], &[f32])) {
    for (gradient, scale) in by_scales.iter_mut().zip(scales) {
        *gradient = finite(f64::from(*gradient) / f64::from(*scale));
    }
    for (gradient, opacity) in by_opacities.iter_mut().zip(opacities) {
        // 1 - o is exact in f64.
        let opacity = inside(*opacity);
        *gradient = finite(f64::from(*gradient) / (opacity * (1.0 - opacity)));
    }
}

/// A number as f32: at most the largest there is, and 0 for what is none.
#[inline(always)]
pub(crate) fn finite(value: f64) -> f32 {
    if value.is_nan() { 0.0 } else { value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32 }
}

/// `length` zeros, in the memory of `numbers` if that has the right length. Fresh memory is one page of zeros shown many times: to read a
/// number and write it back would have the system make room for each page twice, and stop all threads every time. So it is filled first.
fn clear(numbers: &mut Vec<f32>, length: usize) {
    if numbers.len() != length {
        *numbers = vec![0.0; length];
    }
    numbers.par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
}

/// Derivatives of a loss with respect to a camera: by the world-to-camera pose `p_camera = R p_world + t`, its twelve numbers taken as
/// independent, and by the focal length. The camera centre, from which SH colours are seen, is -Rᵀ t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraGradient {
    /// By the entries of R.
    pub rotation: DMat3,
    /// By t, 1 / scene units.
    pub translation: DVec3,
    /// By the logarithm of a factor of both focal lengths.
    pub focal: f64,
}

impl CameraGradient {
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
