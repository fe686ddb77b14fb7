//! The rasterizer: renders and differentiates on any device.

#[cfg(feature = "gpu")]
use crate::gpu::{self, AdapterChoice, Gpu, GpuOptions};
use crate::{Activated, Error, Gradients, PixelGradients, RenderSettings, Rendering, Result, Style, cpu};
use cpu::Source;
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
        settings.check()?;
        match &mut self.backend {
            Backend::Cpu(scratch) => {
                let source = Source::Stored(gaussians);
                cameras.iter().map(|camera| cpu::render(source, camera, settings, scratch)).collect()
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => gpu.render(gaussians, cameras, settings),
        }
    }

    /// As [`Rasterizer::render_views`], of activated Gaussians, with the same bytes as a result. The CPU reads the arrays in place; a
    /// GPU gets them as they are stored.
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
        settings.check()?;
        match &mut self.backend {
            Backend::Cpu(scratch) => {
                gaussians.check_lengths()?;
                if cameras.is_empty() {
                    gaussians.check_numbers()?;
                }
                let source = Source::Activated(gaussians);
                cameras.iter().map(|camera| cpu::render(source, camera, settings, scratch)).collect()
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => gpu.render(&gaussians.store()?, cameras, settings),
        }
    }

    /// As [`Rasterizer::render_views`], and keeps what [`Rasterizer::backward`] needs.
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
        if settings.style != Style::Blended {
            return Err(Error::NotBlended);
        }
        let (renderings, views) = match &mut self.backend {
            Backend::Cpu(scratch) => {
                let (mut renderings, mut views) = (Vec::new(), Vec::new());
                for camera in cameras {
                    let (rendering, view) =
                        cpu::record(Source::Stored(gaussians), camera, settings, scratch)?;
                    renderings.push(rendering);
                    views.push(view);
                }
                (renderings, Views::Cpu(views))
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => {
                let (renderings, tape) = gpu.record(gaussians, cameras, settings)?;
                (renderings, Views::Gpu(tape))
            }
        };
        let tape = Tape {
            n_gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree(),
            cameras: cameras.to_vec(),
            settings: *settings,
            views,
        };
        Ok((renderings, tape))
    }

    /// Derivatives of a loss by everything that is stored of the Gaussians, by the background and by the poses, given
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
        Ok(self.differentiate(gaussians, tape, pixels, None)?.0)
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
        self.differentiate(gaussians, tape, pixels, Some(values))
    }

    fn differentiate(
        &mut self,
        gaussians: &Gaussians,
        tape: &Tape,
        pixels: &[PixelGradients],
        values: Option<&[Vec<f32>]>,
    ) -> Result<(Gradients, Vec<[f32; 2]>)> {
        let (found, found_degree) = (gaussians.len(), gaussians.sh_degree());
        if (found, found_degree) != (tape.n_gaussians, tape.sh_degree) {
            let (expected, expected_degree) = (tape.n_gaussians, tape.sh_degree);
            return Err(Error::OtherScene { expected, expected_degree, found, found_degree });
        }
        if pixels.len() != tape.cameras.len() {
            return Err(Error::Views { expected: tape.cameras.len(), found: pixels.len() });
        }
        for (camera, pixels) in tape.cameras.iter().zip(pixels) {
            pixels.check(camera, &tape.settings)?;
        }
        let mut gradients = Gradients::zero(gaussians);
        let mut shares = vec![[0.0; 2]; if values.is_some() { gaussians.len() } else { 0 }];
        match (&mut self.backend, &tape.views) {
            (Backend::Cpu(_), Views::Cpu(views)) => {
                let isa = Isa::in_use();
                for (index, (view, camera)) in views.iter().zip(&tape.cameras).enumerate() {
                    let shares =
                        values.map(|values| cpu::Shares { values: &values[index], sums: &mut shares });
                    let pixels = &pixels[index];
                    let settings = &tape.settings;
                    let found = (&mut gradients, shares);
                    let pose = cpu::backward(gaussians, camera, settings, view, pixels, found, isa);
                    gradients.poses.push(pose);
                }
            }
            #[cfg(feature = "gpu")]
            (Backend::Gpu(_), Views::Gpu(_)) if values.is_some() => return Err(Error::SharesOnGpu),
            #[cfg(feature = "gpu")]
            (Backend::Gpu(gpu), Views::Gpu(views)) => {
                gpu.backward(views, &tape.cameras, pixels, &mut gradients)?;
            }
            #[cfg(feature = "gpu")]
            _ => return Err(Error::OtherDevice),
        }
        Ok((gradients, shares))
    }
}
