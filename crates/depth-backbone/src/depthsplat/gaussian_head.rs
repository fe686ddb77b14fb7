//! DepthSplat's own head: one Gaussian per pixel of every view (`gaussian_regressor`, `gaussian_head`), and what turns
//! its numbers into Gaussians. It is the baseline that sparse heads are held against.

use super::layers::{Conv, Then, join, tensor, values};
use super::params::Params;
use super::taps::{Layout, Taps};
use super::variant::Variant;
use candle_core::{Device, Result, Tensor};
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_scene::{Camera, Gaussians, SH_C0};
use rayon::prelude::*;

/// Numbers per pixel.
const RAW: usize = 37;
/// Coefficients of a colour, degree 2.
const COEFFICIENTS: usize = 9;
/// Bounds of the standard deviations, scene units.
const SCALES: (f32, f32) = (1e-10, 3.0);

/// One Gaussian per pixel: view by view, row by row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PixelGaussians {
    /// Position in the world, `[n, 3]`.
    pub means: Vec<f32>,
    /// Covariance in the world, `[n, 3, 3]`.
    pub covariances: Vec<f32>,
    /// 0..1, `[n]`.
    pub opacities: Vec<f32>,
    /// Standard deviations along the axes, scene units, `[n, 3]`.
    pub scales: Vec<f32>,
    /// Axes relative to the camera as quaternions (x, y, z, w), `[n, 4]`.
    pub rotations: Vec<f32>,
    /// Colours as DepthSplat's rasterizer takes them, `[n, rgb, 9]`: degree 0 as in 3DGS; its degrees 1 and 2 are turned
    /// to the world in a basis of other signs than those that it evaluates, with which the models were trained.
    pub harmonics: Vec<f32>,
}

/// Maps of one view at the size of the image, `[1, h, w, ..]`.
pub(super) struct HeadInputs<'a> {
    pub(super) image: &'a Tensor,
    pub(super) depth: &'a Tensor,
    pub(super) match_probability: &'a Tensor,
    pub(super) features: &'a Tensor,
}

pub(super) struct GaussianHead {
    regressor: [Conv; 2],
    head: [Conv; 2],
}

impl GaussianHead {
    /// `p`: the whole encoder.
    pub(super) fn new(p: &Params, variant: Variant) -> Result<Self> {
        let features = 2 * variant.vit.dpt_width();
        let (regressor, head) = (p.pp("gaussian_regressor"), p.pp("gaussian_head"));
        Ok(Self {
            regressor: [
                Conv::shape(3, 3 + 1 + 1 + features, 64).load(&regressor.pp(0))?,
                Conv::shape(3, 64, 64).load(&regressor.pp(2))?,
            ],
            head: [
                Conv::shape(3, 64 + 3 + features + 1, RAW).replicate().load(&head.pp(0))?,
                Conv::shape(3, RAW, RAW).replicate().load(&head.pp(2))?,
            ],
        })
    }

    /// The Gaussians of a view, row by row; what lies outside the camera's image was padded and has none.
    pub(super) fn forward(
        &self,
        x: &HeadInputs<'_>,
        camera: &Camera,
        taps: &mut Taps,
    ) -> Result<Vec<PixelGaussian>> {
        let HeadInputs { image, depth, match_probability, features } = *x;
        let y = self.regressor[0]
            .forward_then(&join(&[image, depth, match_probability, features])?, Then::GELU)?;
        let g = self.regressor[1].forward(&y)?;
        taps.map("head.regressor", &g)?;
        let y = self.head[0].forward_then(&join(&[&g, image, features, match_probability])?, Then::GELU)?;
        let raw = self.head[1].forward(&y)?;
        taps.map("head.raw", &raw)?;
        let cropped = |t: &Tensor| {
            let t = t.narrow(1, 0, camera.height())?.narrow(2, 0, camera.width())?;
            t.to_device(&Device::Cpu)?.contiguous()
        };
        let (raw, image, depth) = (cropped(&raw)?, cropped(image)?, cropped(depth)?);
        let (raw, image, depth) = (values(&raw)?, values(&image)?, values(&depth)?);
        let frame = Frame { camera, turn: second_degree(camera.rotation().transpose()) };
        let pixels =
            raw.as_chunks::<RAW>().0.par_iter().zip(image.as_chunks::<3>().0.par_iter()).zip(&*depth);
        Ok(pixels.enumerate().map(|(i, ((raw, rgb), &depth))| frame.gaussian(i, raw, rgb, depth)).collect())
    }
}

/// What a pixel's numbers mean.
#[derive(Debug, Clone)]
pub(super) struct PixelGaussian {
    mean: [f32; 3],
    opacity_logit: f32,
    scales: [f32; 3],
    /// Relative to the camera, (x, y, z, w).
    rotation: [f64; 4],
    /// Columns in the world, of length one.
    axes: DMat3,
    harmonics: [[f32; COEFFICIENTS]; 3],
}

/// A view, and how it turns functions of degree 2.
struct Frame<'a> {
    camera: &'a Camera,
    turn: [[f64; 5]; 5],
}

impl Frame<'_> {
    /// The Gaussian of pixel `i` from its numbers, colour and depth.
    fn gaussian(&self, i: usize, raw: &[f32; RAW], rgb: &[f32; 3], depth: f32) -> PixelGaussian {
        let width = self.camera.width();
        let to_world = self.camera.rotation().transpose();
        // Half a pixel at most from the pixel's centre.
        let offset = DVec2::new(sigmoid(raw[1]), sigmoid(raw[2]));
        let pixel = DVec2::new((i % width) as f64, (i / width) as f64) + offset;
        let scales = [raw[3], raw[4], raw[5]].map(|v| {
            let v = f64::from(v) - 4.0;
            // Softplus, without overflow.
            ((v.max(0.0) + (-v.abs()).exp().ln_1p()) as f32).clamp(SCALES.0, SCALES.1)
        });
        let q = [raw[6], raw[7], raw[8], raw[9]].map(f64::from);
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt() + 1e-8;
        let q = q.map(|v| v / norm);
        let coefficients = raw[10..].as_chunks::<COEFFICIENTS>().0;
        PixelGaussian {
            mean: single(self.camera.unproject(pixel, depth.into())),
            opacity_logit: raw[0],
            scales,
            rotation: q,
            axes: to_world * rotation(q),
            harmonics: std::array::from_fn(|c| harmonics(&coefficients[c], rgb[c], to_world, &self.turn)),
        }
    }
}

impl PixelGaussian {
    /// Appends it to a set of SH degree 2, where the harmonics are evaluated as DepthSplat's rasterizer does.
    pub(super) fn push_to(&self, set: &mut Gaussians) {
        let q = DQuat::from_mat3(&self.axes);
        let quaternion = [q.w, q.x, q.y, q.z].map(|v| v as f32);
        let mut sh = [0.0; 3 * COEFFICIENTS];
        for (k, rgb) in sh.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *rgb = std::array::from_fn(|channel| self.harmonics[channel][k]);
        }
        set.push(self.mean, quaternion, self.scales.map(f32::ln), self.opacity_logit, &sh);
    }
}

fn sigmoid(x: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(x)).exp())
}

impl PixelGaussians {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    pub(super) fn push(&mut self, pixel: &PixelGaussian) {
        self.means.extend(pixel.mean);
        let axes = pixel.axes * DMat3::from_diagonal(DVec3::from_array(pixel.scales.map(f64::from)));
        let covariance = axes * axes.transpose();
        (0..3).for_each(|row| self.covariances.extend(single(covariance.row(row))));
        self.opacities.push(sigmoid(pixel.opacity_logit) as f32);
        self.scales.extend(pixel.scales);
        self.rotations.extend(pixel.rotation.map(|v| v as f32));
        pixel.harmonics.iter().for_each(|coefficients| self.harmonics.extend(coefficients));
    }

    /// Notes all of them under the names of the golden files.
    pub(super) fn note(&self, taps: &mut Taps) -> Result<()> {
        let n = self.len();
        let mut note = |name: &str, values: &[f32], shape: &[usize]| {
            taps.note(format!("gauss.{name}"), Layout::Plain, &tensor(values.to_vec(), shape)?)
        };
        note("means", &self.means, &[1, n, 3])?;
        note("cov", &self.covariances, &[1, n, 3, 3])?;
        note("opacity", &self.opacities, &[1, n])?;
        note("scales", &self.scales, &[1, n, 3])?;
        note("rot", &self.rotations, &[1, n, 4])?;
        note("sh", &self.harmonics, &[1, n, 3, COEFFICIENTS])
    }
}

fn single(v: DVec3) -> [f32; 3] {
    v.to_array().map(|v| v as f32)
}

/// The rotation of a quaternion (x, y, z, w), which need not have length one.
fn rotation(q: [f64; 4]) -> DMat3 {
    let q = DQuat::from_array(q);
    let length = q.length_squared();
    // As the original: 1e-8 keeps a quaternion of zeros from dividing by zero.
    let s = 2.0 / (length + 1e-8);
    let [i, j, k, w] = q.to_array();
    DMat3::from_cols(
        DVec3::new(1.0 - s * (j * j + k * k), s * (i * j + k * w), s * (i * k - j * w)),
        DVec3::new(s * (i * j - k * w), 1.0 - s * (i * i + k * k), s * (j * k + i * w)),
        DVec3::new(s * (i * k + j * w), s * (j * k - i * w), 1.0 - s * (i * i + j * j)),
    )
}

/// Coefficients of a colour channel: higher degrees damped, the pixel's own colour added, turned to the world.
fn harmonics(
    raw: &[f32; COEFFICIENTS],
    colour: f32,
    to_world: DMat3,
    second: &[[f64; 5]; 5],
) -> [f32; COEFFICIENTS] {
    let damped = |k: usize| f64::from(raw[k]) * if k < 4 { 0.025 } else { 0.00625 };
    let first = to_world * DVec3::new(damped(1), damped(2), damped(3));
    let mut out = [0.0; COEFFICIENTS];
    out[0] = (f64::from(raw[0]) + (f64::from(colour) - 0.5) / f64::from(SH_C0)) as f32;
    for (k, v) in first.to_array().into_iter().enumerate() {
        out[1 + k] = v as f32;
    }
    for (k, row) in second.iter().enumerate() {
        out[4 + k] = (0..5).map(|b| row[b] * damped(4 + b)).sum::<f64>() as f32;
    }
    out
}

/// How a rotation turns the functions of degree 2, in the order √3 xz, √3 xy, y² - (x² + z²)/2, √3 yz, √3/2 (z² - x²):
/// each is d ↦ dᵀ B d with a symmetric B.
fn second_degree(rotation: DMat3) -> [[f64; 5]; 5] {
    let h = 3.0_f64.sqrt() / 2.0;
    let symmetric = |d: [f64; 3], xy: f64, xz: f64, yz: f64| {
        DMat3::from_cols(DVec3::new(d[0], xy, xz), DVec3::new(xy, d[1], yz), DVec3::new(xz, yz, d[2]))
    };
    let basis = [
        symmetric([0.0; 3], 0.0, h, 0.0),
        symmetric([0.0; 3], h, 0.0, 0.0),
        symmetric([-0.5, 1.0, -0.5], 0.0, 0.0, 0.0),
        symmetric([0.0; 3], 0.0, 0.0, h),
        symmetric([-h, 0.0, h], 0.0, 0.0, 0.0),
    ];
    let inner = |a: DMat3, b: DMat3| -> f64 {
        a.to_cols_array().iter().zip(b.to_cols_array()).map(|(a, b)| a * b).sum()
    };
    let turned = basis.map(|b| rotation * b * rotation.transpose());
    basis.map(|a| turned.map(|b| inner(a, b) * (2.0 / 3.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Functions of degree 2 of a turned direction are the turned coefficients' function of the direction.
    #[test]
    fn degree_two_turns_with_the_direction() {
        let r = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
        let d = second_degree(r);
        let s = 3.0_f64.sqrt();
        let functions = |v: DVec3| {
            let DVec3 { x, y, z } = v;
            [s * x * z, s * x * y, y * y - (x * x + z * z) / 2.0, s * y * z, s / 2.0 * (z * z - x * x)]
        };
        let c = [0.3, -0.2, 0.7, 0.1, -0.9];
        let direction = DVec3::new(0.4, -0.3, 0.8).normalize();
        let before: f64 = functions(r.transpose() * direction).iter().zip(c).map(|(f, c)| f * c).sum();
        let turned = d.map(|row| row.iter().zip(c).map(|(d, c)| d * c).sum::<f64>());
        let after: f64 = functions(direction).iter().zip(turned).map(|(f, c)| f * c).sum();
        assert!((before - after).abs() < 1e-12);
    }
}
