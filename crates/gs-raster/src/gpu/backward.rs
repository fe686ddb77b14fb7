//! The backward pass on the GPU.

use super::context::Gpu;
use super::forward::{Tape, ViewTape};
use super::passes::StoredSums;
use super::pool::{Pooled, Use};
use super::upload::Upload;
use crate::{CameraGradient, Error, Gradients, PixelGradients, Result};
use glam::{DMat3, DVec3};
use gs_scene::Camera;
use gs_shaders::{PAIR_GRADS, PIXEL_GRADS, POSE_SUMS, WORKGROUP};
use std::collections::VecDeque;

/// Views whose backward passes may be under way at a time: each holds the gradients by its pixels in the main memory until it is done.
const AHEAD: usize = 3;

impl Gpu {
    /// Puts the derivatives of all views into `gradients`, whose arrays have their lengths.
    pub(crate) fn backward(
        &mut self,
        tape: &Tape,
        cameras: &[Camera],
        pixels: &[PixelGradients],
        gradients: &mut Gradients,
    ) -> Result<()> {
        if !self.pool.owns(&tape.upload.geometry) {
            return Err(Error::OtherDevice);
        }
        let sums = StoredSums {
            geometry: self.pool.take(Use::Storage, size_of_val(&gradients.geometry[..]) as u64),
            sh: self.pool.take(Use::Storage, size_of_val(&gradients.sh[..]) as u64),
        };
        let mut recording = self.recording();
        for sum in [&sums.geometry, &sums.sh] {
            recording.encoder().clear_buffer(sum, 0, None);
        }
        self.submit(recording)?;
        let mut waiting = VecDeque::new();
        for ((view, camera), pixels) in tape.views.iter().zip(cameras).zip(pixels) {
            for (pixel, t) in pixels.image.chunks_exact(3).zip(&view.transmittance) {
                for (background, v) in gradients.background.iter_mut().zip(pixel) {
                    *background += f64::from(*v) * f64::from(*t);
                }
            }
            waiting.push_back((self.view_backward(&tape.upload, view, pixels, &sums)?, camera));
            if waiting.len() > AHEAD {
                self.camera_of_first(&mut waiting, gradients)?;
            }
        }
        let mut recording = self.recording();
        let staged = [&sums.geometry, &sums.sh].map(|buffer| self.stage(&mut recording, buffer));
        self.submit(recording)?;
        while !waiting.is_empty() {
            self.camera_of_first(&mut waiting, gradients)?;
        }
        self.read_into(&staged[0], &mut gradients.geometry)?;
        self.read_into(&staged[1], &mut gradients.sh)
    }

    /// Waits for the first of these views, and adds the gradient by its camera.
    fn camera_of_first(
        &self,
        waiting: &mut VecDeque<(Pooled, &Camera)>,
        gradients: &mut Gradients,
    ) -> Result<()> {
        let Some((staged, camera)) = waiting.pop_front() else { return Ok(()) };
        let mut sums = [0.0; POSE_SUMS];
        for group in self.read::<f32>(&staged)?.chunks_exact(POSE_SUMS) {
            for (sum, value) in sums.iter_mut().zip(group) {
                *sum += f64::from(*value);
            }
        }
        gradients.cameras.push(camera_gradient(&sums, camera));
        Ok(())
    }

    /// Submits the backward pass of a view, which adds to `sums`; gives the sums by its pose, staged. Nothing waits for the GPU.
    fn view_backward(
        &mut self,
        upload: &Upload,
        view: &ViewTape,
        pixels: &PixelGradients,
        sums: &StoredSums,
    ) -> Result<Pooled> {
        let pixel_grads = self.pool.storage(&pixel_gradients(view, pixels));
        let row = |numbers: usize| (numbers * size_of::<f32>()) as u64;
        let pair_grads = self.pool.take(Use::Storage, u64::from(view.n_pairs) * row(PAIR_GRADS));
        let groups = upload.n.div_ceil(WORKGROUP);
        let pose_sums = self.pool.take(Use::Storage, u64::from(groups) * row(POSE_SUMS));
        let mut recording = self.recording();
        let by_depth = pixels.depth.is_some();
        self.rasterize_backward(&mut recording, &view.buffers, &pixel_grads, &pair_grads, by_depth);
        self.project_backward(&mut recording, upload, &view.buffers, &pair_grads, sums, &pose_sums);
        let staged = self.stage(&mut recording, &pose_sums);
        self.submit(recording)?;
        Ok(staged)
    }
}

/// The pixel gradients in the layout of `rasterize_backward`, `[h, w, PIXEL_GRADS]`. With depth D = Σ w z / W, W = Σ w = 1 - T:
/// by Σ w z v_D / W, by T v_D D / W; and by T what comes through alpha, -v_alpha.
fn pixel_gradients(view: &ViewTape, pixels: &PixelGradients) -> Vec<f32> {
    let mut grads = Vec::with_capacity(view.transmittance.len() * PIXEL_GRADS);
    for (pixel, &transmittance) in view.transmittance.iter().enumerate() {
        grads.extend_from_slice(&pixels.image[pixel * 3..pixel * 3 + 3]);
        let mut by_transmittance = -pixels.alpha.as_ref().map_or(0.0, |alpha| alpha[pixel]);
        let mut by_sum = 0.0;
        if let (Some(grad), Some([depth, weight])) = (&pixels.depth, &view.depth)
            && weight[pixel] > 0.0
        {
            by_sum = grad[pixel] / weight[pixel];
            by_transmittance += by_sum * depth[pixel];
        }
        grads.extend_from_slice(&[by_transmittance, by_sum, transmittance]);
    }
    grads
}

/// The gradient by a camera from its sums over Gaussians: by D in p ← D p (9), by t (3), and by the camera centre -Rᵀ t through
/// colours (3). As p = R m + t, the derivative by R is (that by D, less that by t times tᵀ) R⁻ᵀ. A longer focal length is a stretch of x
/// and y that leaves the centre where it is.
fn camera_gradient(sums: &[f64; POSE_SUMS], camera: &Camera) -> CameraGradient {
    let vector = |start: usize| DVec3::new(sums[start], sums[start + 1], sums[start + 2]);
    let by_centre = vector(12);
    let (by_axes, by_t) = (DMat3::from_cols(vector(0), vector(3), vector(6)).transpose(), vector(9));
    let t = camera.translation();
    // R itself but for rounding, which far from the world's origin would be seen.
    let to_rows = camera.rotation().inverse().transpose();
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    CameraGradient {
        rotation: (by_axes - outer(by_t, t)) * to_rows - outer(t, by_centre),
        translation: by_t - camera.rotation() * by_centre,
        focal: sums[0] + sums[4],
    }
}
