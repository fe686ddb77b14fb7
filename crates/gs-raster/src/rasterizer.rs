//! The rasterizer: renders and differentiates on any device.

#[cfg(feature = "gpu")]
use crate::gpu::{self, AdapterChoice, Gpu, GpuOptions};
use crate::{
    Activated, ActivatedGradients, CameraGradient, Error, Gradients, PixelGradients, RenderSettings,
    Rendering, Result, Style, cpu,
};
use cpu::{Source, Sums};
use cpu_kernels::Isa;
use gs_scene::{Camera, Gaussians};

/// Where to render.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
    /// On a GPU if there is a real one that passes the self-test, else on the CPU.
    #[default]
    Auto,
    /// On a GPU; where there is only a software adapter, on that.
    Gpu,
    /// On the CPU.
    Cpu,
}

/// Renders scenes and differentiates renderings; keeps its buffers from one frame to the next.
#[derive(Debug)]
pub struct Rasterizer {
    backend: Backend,
    /// Why [`Device::Auto`] did not take a GPU.
    fallback: Option<Error>,
}

#[derive(Debug)]
enum Backend {
    Cpu(cpu::Scratch),
    #[cfg(feature = "gpu")]
    Gpu(Box<Gpu>),
}

/// What [`Rasterizer::backward`] needs to know of a forward pass.
#[derive(Debug)]
pub struct Tape {
    n_gaussians: usize,
    sh_degree: usize,
    /// Whether activated Gaussians were recorded.
    is_activated: bool,
    cameras: Vec<Camera>,
    settings: RenderSettings,
    views: Views,
}

#[derive(Debug)]
enum Views {
    Cpu(Vec<cpu::Tape>),
    #[cfg(feature = "gpu")]
    Gpu(gpu::Tape),
}

impl Rasterizer {
    /// A rasterizer on a device.
    ///
    /// # Errors
    /// If [`Device::Gpu`] is asked for and there is none, it does not start, or it fails its self-test.
    pub fn new(device: Device) -> Result<Self> {
        #[cfg(feature = "gpu")]
        match device {
            Device::Cpu => Ok(Self::cpu()),
            Device::Gpu => {
                Self::gpu(&GpuOptions { adapter: AdapterChoice::OrSoftware, ..GpuOptions::default() })
            }
            Device::Auto => Ok(Self::gpu(&GpuOptions::default())
                .unwrap_or_else(|error| Self { fallback: Some(error), ..Self::cpu() })),
        }
        #[cfg(not(feature = "gpu"))]
        match device {
            Device::Cpu | Device::Auto => Ok(Self::cpu()),
            Device::Gpu => Err(Error::NoAdapter { found: "no graphics interface in this build".to_owned() }),
        }
    }

    /// A rasterizer on the CPU. It uses all threads of the current rayon pool; results do not depend on their number.
    #[must_use]
    pub fn cpu() -> Self {
        Self { backend: Backend::Cpu(cpu::Scratch::default()), fallback: None }
    }

    /// A rasterizer on a GPU. Results are the same from run to run on one adapter.
    ///
    /// # Errors
    /// If no adapter comes into question, it does not start, or it fails its self-test.
    #[cfg(feature = "gpu")]
    pub fn gpu(options: &GpuOptions) -> Result<Self> {
        Ok(Self { backend: Backend::Gpu(Box::new(Gpu::new(options)?)), fallback: None })
    }

    /// The GPU that is used, if one is.
    #[cfg(feature = "gpu")]
    #[must_use]
    pub fn adapter(&self) -> Option<&gpu::AdapterDescription> {
        match &self.backend {
            Backend::Cpu(_) => None,
            Backend::Gpu(gpu) => Some(gpu.adapter()),
        }
    }

    /// Why [`Device::Auto`] took the CPU: no real GPU, or one that does not start or fails its self-test.
    #[must_use]
    pub fn fallback(&self) -> Option<&Error> {
        self.fallback.as_ref()
    }

    /// Renders `gaussians` as seen by `camera`.
    ///
    /// Gaussians whose stored values are not finite are left out and counted in
    /// [`RenderStats::rejected`](crate::RenderStats::rejected).
    ///
    /// # Errors
    /// If a setting lies outside its range, the Gaussians touch more tiles than memory can hold, the scene or the image
    /// is too large for the GPU, or the GPU fails.
    #[expect(clippy::missing_panics_doc, reason = "of one camera there is one view")]
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Rendering> {
        let mut views = self.render_views(gaussians, std::slice::from_ref(camera), settings)?;
        Ok(views.pop().expect("one camera, one view"))
    }

    /// Renders `gaussians` as seen by each of `cameras`; the scene goes to the GPU once.
    ///
    /// # Errors
    /// As [`Rasterizer::render`].
    pub fn render_views(
        &mut self,
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<Vec<Rendering>> {
        self.render_source(Source::Stored(gaussians), cameras, settings)
    }

    /// As [`Rasterizer::render_views`], of activated Gaussians. The CPU reads the arrays in place; a GPU gets them as they are stored, and so
    /// does the CPU for [`Style::Ellipsoids`](crate::Style::Ellipsoids).
    ///
    /// # Errors
    /// As [`Rasterizer::render`] and [`Activated::store`]: where a stored Gaussian would be counted as rejected because a number is not
    /// finite, this is an error.
    pub fn render_activated(
        &mut self,
        gaussians: &Activated<'_>,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<Vec<Rendering>> {
        self.render_source(Source::Activated(gaussians), cameras, settings)
    }

    fn render_source(
        &mut self,
        source: Source<'_>,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<Vec<Rendering>> {
        settings.check()?;
        check(source, cameras)?;
        match &mut self.backend {
            Backend::Cpu(scratch) => {
                cameras.iter().map(|camera| cpu::render(source, camera, settings, scratch)).collect()
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => gpu.render(source.stored()?.as_ref(), cameras, settings),
        }
    }

    /// As [`Rasterizer::render_views`], and keeps what [`Rasterizer::backward`] needs. The CPU renders the views side by side.
    ///
    /// # Errors
    /// As [`Rasterizer::render`].
    pub fn record(
        &mut self,
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<(Vec<Rendering>, Tape)> {
        self.record_source(Source::Stored(gaussians), cameras, settings)
    }

    /// As [`Rasterizer::record`], of activated Gaussians, for [`Rasterizer::backward_activated`]. The CPU reads the arrays in place; a
    /// GPU gets them as they are stored.
    ///
    /// # Errors
    /// As [`Rasterizer::render_activated`].
    pub fn record_activated(
        &mut self,
        gaussians: &Activated<'_>,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<(Vec<Rendering>, Tape)> {
        self.record_source(Source::Activated(gaussians), cameras, settings)
    }

    fn record_source(
        &mut self,
        source: Source<'_>,
        cameras: &[Camera],
        settings: &RenderSettings,
    ) -> Result<(Vec<Rendering>, Tape)> {
        settings.check()?;
        if settings.style != Style::Blended {
            return Err(Error::NotBlended);
        }
        check(source, cameras)?;
        let (renderings, views) = match &mut self.backend {
            Backend::Cpu(scratch) => {
                let (renderings, views) = cpu::record_views(source, cameras, settings, scratch)?;
                (renderings, Views::Cpu(views))
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => {
                let (renderings, tape) = gpu.record(source.stored()?.as_ref(), cameras, settings)?;
                (renderings, Views::Gpu(tape))
            }
        };
        let tape = Tape {
            n_gaussians: source.len(),
            sh_degree: source.sh_degree(),
            is_activated: source.is_activated(),
            cameras: cameras.to_vec(),
            settings: *settings,
            views,
        };
        Ok((renderings, tape))
    }

    /// Derivatives of a loss by everything that is stored of the Gaussians, by the background and by the cameras, given
    /// those by the pixels of the recorded views. `gaussians` is the scene that was recorded, by this rasterizer.
    ///
    /// # Errors
    /// If `gaussians` or `pixels` do not have the size of what was recorded, a number in `pixels` is not finite, depth
    /// has a gradient but was not rendered, another device recorded the tape, or the GPU fails.
    pub fn backward(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
    ) -> Result<Gradients> {
        let mut found = Gradients::default();
        self.backward_into(gaussians, tape, pixels, &mut found)?;
        Ok(found)
    }

    /// As [`Rasterizer::backward`], in place of what `found` held. On the CPU its arrays are used again where they have the right length: fresh memory
    /// costs as much time as filling it.
    ///
    /// # Errors
    /// As [`Rasterizer::backward`]; `found` then holds nothing of meaning.
    pub fn backward_into(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
        found: &mut Gradients,
    ) -> Result<()> {
        self.differentiate(gaussians, tape, pixels, None, found).map(drop)
    }

    /// As [`Rasterizer::backward`], by the arrays of activated Gaussians that were recorded; these must hold the same numbers still. On a
    /// GPU they are [`Gradients::activated`] of the gradients by what is stored.
    ///
    /// # Errors
    /// As [`Rasterizer::backward`]; if the lengths of the arrays do not fit each other, or stored Gaussians were recorded.
    pub fn backward_activated(
        &mut self,
        gaussians: &Activated<'_>,
        tape: &Tape,
        pixels: &[PixelGradients],
    ) -> Result<ActivatedGradients> {
        let mut found = ActivatedGradients::default();
        self.backward_activated_into(gaussians, tape, pixels, &mut found)?;
        Ok(found)
    }

    /// As [`Rasterizer::backward_activated`], in place of what `found` held, as [`Rasterizer::backward_into`].
    ///
    /// # Errors
    /// As [`Rasterizer::backward_activated`]; `found` then holds nothing of meaning.
    pub fn backward_activated_into(
        &mut self,
        gaussians: &Activated<'_>,
        tape: &Tape,
        pixels: &[PixelGradients],
        found: &mut ActivatedGradients,
    ) -> Result<()> {
        gaussians.check_lengths()?;
        let source = Source::Activated(gaussians);
        tape.check(source, pixels)?;
        if !tape.is_activated {
            return Err(Error::NotActivated);
        }
        match (&mut self.backend, &tape.views) {
            (Backend::Cpu(scratch), Views::Cpu(views)) => {
                found.clear(gaussians);
                let by_views =
                    tape.differentiate(source, views, pixels, (found.sums(gaussians.kind), None), scratch);
                (found.background, found.cameras) = by_views;
                found.chain_colors(gaussians.kind);
            }
            #[cfg(feature = "gpu")]
            (Backend::Gpu(gpu), Views::Gpu(views)) => {
                let mut gradients = Gradients::default();
                gradients.clear(source.len(), source.sh_degree());
                gpu.backward(views, &tape.cameras, pixels, &mut gradients)?;
                *found = gradients.activated(gaussians);
            }
            #[cfg(feature = "gpu")]
            _ => return Err(Error::OtherDevice),
        }
        Ok(())
    }

    /// As [`Rasterizer::backward`], and for every Gaussian (Σ w, Σ w v): w is its share in a pixel, by which its colour is
    /// multiplied there, v the number of the pixel in `values`, `[height, width]` per view. In one walk over the pixels,
    /// which takes little longer than the derivatives alone. On the CPU only.
    ///
    /// # Errors
    /// As [`Rasterizer::backward`]; if `values` do not have the size of the views; on a GPU.
    pub fn backward_with_shares(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
        values: &[Vec<f32>],
    ) -> Result<(Gradients, Vec<[f32; 2]>)> {
        if values.len() != tape.cameras.len() {
            return Err(Error::Views { expected: tape.cameras.len(), found: values.len() });
        }
        for (camera, values) in tape.cameras.iter().zip(values) {
            let expected = camera.width() * camera.height();
            if values.len() != expected {
                return Err(Error::PixelGradientLength { what: "values", expected, found: values.len() });
            }
        }
        let mut found = Gradients::default();
        let shares = self.differentiate(gaussians, tape, pixels, Some(values), &mut found)?;
        Ok((found, shares))
    }

    fn differentiate(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
        values: Option<&[Vec<f32>]>,
        gradients: &mut Gradients,
    ) -> Result<Vec<[f32; 2]>> {
        let source = Source::Stored(gaussians);
        tape.check(source, pixels)?;
        gradients.clear(source.len(), source.sh_degree());
        let mut shares = vec![[0.0; 2]; if values.is_some() { source.len() } else { 0 }];
        match (&mut self.backend, &tape.views) {
            (Backend::Cpu(scratch), Views::Cpu(views)) => {
                let of_shares = values.map(|values| (values, &mut shares[..]));
                let by_views =
                    tape.differentiate(source, views, pixels, (gradients.sums(), of_shares), scratch);
                (gradients.background, gradients.cameras) = by_views;
            }
            #[cfg(feature = "gpu")]
            (Backend::Gpu(_), Views::Gpu(_)) if values.is_some() => return Err(Error::SharesOnGpu),
            #[cfg(feature = "gpu")]
            (Backend::Gpu(gpu), Views::Gpu(views)) => {
                gpu.backward(views, &tape.cameras, pixels, gradients)?;
            }
            #[cfg(feature = "gpu")]
            _ => return Err(Error::OtherDevice),
        }
        Ok(shares)
    }
}

/// Whether the lengths of activated arrays fit each other and, if no camera looks at them, their numbers are those of Gaussians.
fn check(source: Source<'_>, cameras: &[Camera]) -> Result<()> {
    let Source::Activated(gaussians) = source else { return Ok(()) };
    gaussians.check_lengths()?;
    if cameras.is_empty() { gaussians.check_numbers() } else { Ok(()) }
}

/// Values of the pixels of each view, and the sums of every Gaussian's shares that they weight.
type Weighted<'a> = (&'a [Vec<f32>], &'a mut [[f32; 2]]);

impl Tape {
    /// Whether Gaussians and pixels have the size of what was recorded.
    fn check(&self, source: Source<'_>, pixels: &[PixelGradients]) -> Result<()> {
        let (found, found_degree) = (source.len(), source.sh_degree());
        let (expected, expected_degree) = (self.n_gaussians, self.sh_degree);
        if (found, found_degree) != (expected, expected_degree) {
            return Err(Error::OtherScene { expected, expected_degree, found, found_degree });
        }
        if pixels.len() != self.cameras.len() {
            return Err(Error::Views { expected: self.cameras.len(), found: pixels.len() });
        }
        self.cameras.iter().zip(pixels).try_for_each(|(camera, pixels)| pixels.check(camera, &self.settings))
    }

    /// The backward pass of all views on the CPU: adds the gradients by Gaussians to `sums`, and the shares if they are asked for to the
    /// second part of `shares`. Returns the gradients by the background and by the cameras.
    fn differentiate(
        &self,
        source: Source<'_>,
        views: &[cpu::Tape],
        pixels: &[PixelGradients],
        (mut sums, shares): (Sums<'_>, Option<Weighted<'_>>),
        scratch: &mut cpu::Scratch,
    ) -> ([f64; 3], Vec<CameraGradient>) {
        let (values, shares) = shares.unzip();
        let recorded = self.cameras.iter().zip(views).zip(pixels).enumerate();
        let recorded = recorded.map(|(index, ((camera, tape), pixels))| {
            let values = values.map(|values| values[index].as_slice());
            cpu::Recorded { camera, tape, pixels, values }
        });
        let recorded: Vec<_> = recorded.collect();
        cpu::backward(source, &self.settings, &recorded, &mut sums, shares, (Isa::in_use(), scratch))
    }
}
