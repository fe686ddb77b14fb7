//! What `bench raster` runs.

use crate::bench::measure::timed;
use crate::failure::{OrFail, Outcome};
use gs_raster::{Gradients, PixelGradients, Rasterizer, RenderSettings, RenderStats};
use gs_scene::{Camera, Gaussians};
use rayon::ThreadPool;

/// What runs: a rasterizer, and the threads that it may use.
pub(super) struct Runner<'a> {
    /// `cpu`, or the name of the adapter.
    pub(super) device: String,
    pub(super) rasterizer: Rasterizer,
    pub(super) pool: &'a ThreadPool,
    /// Memory of the run before, as a training step would use it.
    pub(super) gradients: Gradients,
}

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) sh_degree: usize,
    /// What differs from the defaults.
    pub(super) change: fn(&mut RenderSettings),
    /// Whether the backward pass runs as well.
    pub(super) gradients: bool,
}

impl Case {
    pub(super) fn settings(&self) -> RenderSettings {
        let mut settings = RenderSettings::default();
        (self.change)(&mut settings);
        settings
    }
}

/// One row to be measured.
pub(super) struct Job<'a> {
    /// Which of the runners.
    pub(super) runner: usize,
    pub(super) case: Case,
    pub(super) scene: &'a Gaussians,
}

impl Job<'_> {
    /// One run: what was drawn, and the seconds it took.
    pub(super) fn run(&self, runner: &mut Runner<'_>, camera: &Camera) -> Outcome<(RenderStats, f64)> {
        let settings = self.case.settings();
        let pixels = self.case.gradients.then(|| pixel_gradients(camera));
        let Runner { rasterizer, pool, gradients, .. } = runner;
        timed(pool, || match pixels {
            None => Ok(rasterizer.render(self.scene, camera, &settings).or_work()?.stats),
            Some(pixels) => {
                let cameras = std::slice::from_ref(camera);
                let (views, tape) = rasterizer.record(self.scene, cameras, &settings).or_work()?;
                rasterizer.backward_into(self.scene, &tape, &[pixels], gradients).or_work()?;
                Ok(views[0].stats)
            }
        })
    }
}

/// Some gradient by every colour; its value changes no time.
fn pixel_gradients(camera: &Camera) -> PixelGradients<'static> {
    let image = (0..camera.width() * camera.height() * 3).map(|i| ((i % 7) as f32 - 3.0) / 3.0).collect();
    PixelGradients { image, alpha: None, depth: None }
}
