use crate::{Error, Gradients, PixelGradients, RenderSettings, Rendering, Result, cpu};
use gs_scene::{Camera, Gaussians};

/// Renders scenes and differentiates renderings; keeps its buffers from one frame to the next.
#[derive(Debug, Default)]
pub struct Rasterizer {
    scratch: cpu::Scratch,
}

/// What [`Rasterizer::backward`] needs to know of a forward pass.
#[derive(Debug)]
pub struct Tape {
    cameras: Vec<Camera>,
    settings: RenderSettings,
    views: Vec<cpu::Tape>,
}

impl Rasterizer {
    /// A rasterizer on the CPU. It uses all threads of the current rayon pool; results do not depend on their number.
    #[must_use]
    pub fn cpu() -> Self {
        Self::default()
    }

    /// Renders `gaussians` as seen by `camera`.
    ///
    /// Gaussians whose stored values are not finite are left out and counted in
    /// [`RenderStats::rejected`](crate::RenderStats::rejected).
    ///
    /// # Errors
    /// If a setting lies outside its range, or the Gaussians touch more tiles than memory can hold.
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Rendering> {
        settings.check()?;
        cpu::render(gaussians, camera, settings, &mut self.scratch)
    }

    /// As [`Rasterizer::render`], for several views, and keeps what [`Rasterizer::backward`] needs.
    ///
    /// # Errors
    /// As [`Rasterizer::render`].
    pub fn record(
        &mut self,
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<(Vec<Rendering>, Tape)> {
        settings.check()?;
        let mut renderings = Vec::with_capacity(cameras.len());
        let mut views = Vec::with_capacity(cameras.len());
        for camera in cameras {
            let (rendering, tape) = cpu::record(gaussians, camera, settings, &mut self.scratch)?;
            renderings.push(rendering);
            views.push(tape);
        }
        Ok((renderings, Tape { cameras: cameras.to_vec(), settings: *settings, views }))
    }

    /// Derivatives of a loss by everything that is stored of the Gaussians and by the poses, given those by the pixels of
    /// the recorded views. `gaussians` is the scene that was recorded.
    ///
    /// # Errors
    /// If `gaussians` or `pixels` do not have the size of what was recorded, a number in `pixels` is not finite, or
    /// depth has a gradient but was not rendered.
    pub fn backward(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
    ) -> Result<Gradients> {
        if pixels.len() != tape.views.len() {
            return Err(Error::Views { expected: tape.views.len(), found: pixels.len() });
        }
        for (camera, pixels) in tape.cameras.iter().zip(pixels) {
            pixels.check(camera, &tape.settings)?;
        }
        let mut gradients = Gradients::zero(gaussians);
        for ((view, camera), pixels) in tape.views.iter().zip(&tape.cameras).zip(pixels) {
            let pose = cpu::backward(
                gaussians,
                camera,
                &tape.settings,
                view,
                pixels,
                &mut gradients,
                &mut self.scratch,
            )?;
            gradients.poses.push(pose);
        }
        Ok(gradients)
    }
}
