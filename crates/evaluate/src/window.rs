//! One window: context views in, targets rendered and measured.

use crate::figures::{Figures, Seconds, Target, WindowFigures, mean, optional_mean};
use crate::method::Refinement;
use crate::render::{Rendered, render_view};
use crate::{Error, Method, Result};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians, Image, View};
use image_metrics::{Lpips, error_share, psnr, psnr_colour_corrected, ssim};
use scene_windows::Window;
use sparsesplat::{NetworkDevice, Prediction, Predictor, Stage};
use std::time::Instant;

/// A method with its weights in memory.
#[derive(Debug, Clone)]
pub struct Runner {
    method: Method,
    predictor: Predictor,
}

/// What is being done, for progress bars.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Step {
    /// Photographs are read.
    Load,
    /// A stage of the pipeline begins.
    Predict(Stage),
    /// A step of refinement is done.
    Refine {
        /// Share of the steps, or of the time, that is behind, 0 to 1.
        progress: f64,
        /// Mean PSNR over the context views, dB.
        psnr_context: f64,
    },
    /// A view is rendered and measured.
    Render,
}

/// What a window gave.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Its figures.
    pub figures: WindowFigures,
    /// The scene, and the depth it stands on.
    pub prediction: Prediction,
    /// A rendering of each target.
    pub renderings: Vec<Rendered>,
}

/// Adds up the wall time of what is timed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stopwatch {
    /// Wall time so far, seconds.
    pub seconds: f64,
}

impl Stopwatch {
    /// A stopwatch at 0.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Does the work and adds its time.
    pub fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let begin = Instant::now();
        let result = work();
        self.seconds += begin.elapsed().as_secs_f64();
        result
    }
}

/// An outcome with the figures that need no rendering; `pass` are the seconds of the pass.
fn outcome(
    window: &Window,
    method: &Method,
    prediction: Prediction,
    refinement: Option<Refinement>,
    pass: f64,
) -> Outcome {
    let refine = refinement.as_ref().map_or(0.0, |refinement| refinement.report.seconds);
    let total = window.load_seconds + pass + refine;
    let stages = prediction.seconds;
    let seconds = Seconds { load: window.load_seconds, stages, refine, total, ..Seconds::default() };
    let figures = Figures {
        gaussians: prediction.counts.total as f64,
        gaussians_shell: prediction.counts.shell as f64,
        seconds,
        ..Figures::mean(&[])
    };
    let figures = WindowFigures {
        seed: method.predict.seed,
        figures,
        counts: prediction.counts.clone(),
        tau: prediction.tau,
        depth_range: prediction.depth_range,
        exposure: prediction.exposure.clone(),
        corrected_by: prediction.corrected_by.clone(),
        refinement,
        per_target: Vec::new(),
    };
    Outcome { figures, prediction, renderings: Vec::new() }
}

impl Runner {
    /// Reads the method's weights; networks run on the CPU.
    ///
    /// # Errors
    /// If the method's settings contradict each other, or its weights cannot be read.
    pub fn new(method: Method) -> Result<Self> {
        Self::on(method, NetworkDevice::Cpu)
    }

    /// The same, with networks on `device`.
    ///
    /// # Errors
    /// As [`Runner::new`], or if there is no such device.
    pub fn on(method: Method, device: NetworkDevice) -> Result<Self> {
        let predictor = Predictor::on(method.pass(), device)?;
        Ok(Self { method, predictor })
    }

    /// Another method; weights that this one has read are not read again.
    ///
    /// # Errors
    /// As [`Runner::new`].
    pub fn with_method(&self, method: Method) -> Result<Self> {
        let predictor = self.predictor.with_config(method.pass())?;
        Ok(Self { method, predictor })
    }

    /// The method.
    #[must_use]
    pub fn method(&self) -> &Method {
        &self.method
    }

    fn predict(&self, window: &Window, on_step: &mut dyn FnMut(Step)) -> Result<Prediction> {
        let (views, predictor) = (&window.context, &self.predictor);
        let Some(cache) = &self.method.cache else {
            return Ok(predictor.predict(views, &mut |stage| on_step(Step::Predict(stage)))?);
        };
        on_step(Step::Predict(Stage::Backbone));
        let mut asked = Stopwatch::new();
        let geometry = asked.time(|| cache.geometry(&window.name, views, predictor, predictor.wanted()))?;
        let mut prediction =
            predictor.predict_from(views, &geometry, &mut |stage| on_step(Step::Predict(stage)))?;
        prediction.seconds[Stage::Backbone] = asked.seconds;
        Ok(prediction)
    }

    /// Reconstructs a window and renders none of its views: figures that need a rendering are NaN.
    ///
    /// # Errors
    /// If the views do not suffice for the settings, or the scene cannot be refined.
    pub fn reconstruct(
        &self,
        window: &Window,
        rasterizer: &mut Rasterizer,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<Outcome> {
        let mut taken = Stopwatch::new();
        let mut prediction = taken.time(|| self.predict(window, on_step))?;
        let nothing = |_: &Gaussians, _: &mut Rasterizer| Ok(f64::NAN);
        let refinement = self.method.refine(window, &mut prediction, rasterizer, &nothing, on_step)?;
        Ok(outcome(window, &self.method, prediction, refinement, taken.seconds))
    }

    /// Reconstructs a window, renders its targets and its context views, and measures them. Renderings are
    /// compared as they are, floats clipped to 0..1, over a black background, in the exposure that the scene has
    /// from there: nothing is fitted to a target. With refinement the targets are measured with the scene of the pass as well, outside the time that is
    /// measured. LPIPS is measured where there
    /// are weights for it.
    ///
    /// # Errors
    /// If the views do not suffice for the settings, the scene cannot be refined, a view cannot be rendered, or
    /// the sizes of two pictures that are to be compared differ.
    pub fn measure(
        &self,
        window: &Window,
        lpips: Option<&Lpips>,
        rasterizer: &mut Rasterizer,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<Outcome> {
        let method = &self.method;
        let mut taken = Stopwatch::new();
        let mut prediction = taken.time(|| self.predict(window, on_step))?;
        let mut before = Vec::new();
        if method.refine.is_some() {
            let passed = method.passed(window, &prediction)?;
            for target in &window.targets {
                on_step(Step::Render);
                let image = render_view(rasterizer, &passed, target.camera())?.image;
                before.push((compare(psnr, target, &image)?, compare(ssim, target, &image)?));
            }
        }
        let held_out = |scene: &Gaussians, rasterizer: &mut Rasterizer| -> Result<f64> {
            let each = window
                .targets
                .iter()
                .map(|target| compare(psnr, target, &render_view(rasterizer, scene, target.camera())?.image));
            Ok(mean(each.collect::<Result<Vec<_>>>()?.into_iter()))
        };
        let refinement = method.refine(window, &mut prediction, rasterizer, &held_out, on_step)?;
        let camera = |view: &View| {
            refinement.as_ref().map_or(*view.camera(), |found| found.camera(view, &window.context))
        };
        let target_cameras: Vec<Camera> = window.targets.iter().map(camera).collect();
        let context_cameras = refinement.as_ref().map_or_else(
            || window.context.iter().map(|view| *view.camera()).collect(),
            |found| found.cameras.clone(),
        );
        let Outcome { mut figures, prediction, .. } =
            outcome(window, method, prediction, refinement, taken.seconds);

        let mut rendering = Stopwatch::new();
        let mut render_timed = |camera: &Camera| {
            on_step(Step::Render);
            rendering.time(|| render_view(rasterizer, &prediction.gaussians, camera))
        };
        let mut renderings = Vec::with_capacity(window.targets.len());
        for (i, (target, camera)) in window.targets.iter().zip(&target_cameras).enumerate() {
            let rendered = render_timed(camera)?;
            let nearest = nearest_view(target, &window.context)?;
            figures.per_target.push(Target {
                name: target.name().to_owned(),
                psnr: compare(psnr, target, &rendered.image)?,
                ssim: compare(ssim, target, &rendered.image)?,
                lpips: lpips_of(lpips, target, &rendered.image)?,
                psnr_colour_corrected: compare(psnr_colour_corrected, target, &rendered.image)?,
                error_in_worst_tenth: compare(|a, b| error_share(a, b, 0.1), target, &rendered.image)?,
                psnr_feed_forward: before.get(i).map(|(psnr, _)| *psnr),
                nearest_view: nearest.name().to_owned(),
                psnr_nearest_view: compare(psnr, target, nearest.image())?,
            });
            renderings.push(rendered);
        }
        let mut context_psnr = Vec::with_capacity(window.context.len());
        for (view, camera) in window.context.iter().zip(&context_cameras) {
            context_psnr.push(compare(psnr, view, &render_timed(camera)?.image)?);
        }
        let targets = &figures.per_target;
        let means = &mut figures.figures;
        means.psnr_held_out = mean(targets.iter().map(|target| target.psnr));
        means.ssim_held_out = mean(targets.iter().map(|target| target.ssim));
        means.lpips_held_out = optional_mean(targets.iter().map(|target| target.lpips));
        means.psnr_colour_corrected = mean(targets.iter().map(|target| target.psnr_colour_corrected));
        means.error_in_worst_tenth = mean(targets.iter().map(|target| target.error_in_worst_tenth));
        means.psnr_held_out_feed_forward = mean(before.iter().map(|(psnr, _)| *psnr));
        means.ssim_held_out_feed_forward = mean(before.iter().map(|(_, ssim)| *ssim));
        means.psnr_all = mean(targets.iter().map(|target| target.psnr).chain(context_psnr));
        means.psnr_nearest_view = mean(targets.iter().map(|target| target.psnr_nearest_view));
        means.seconds.render = rendering.seconds;
        means.seconds.total += rendering.seconds;
        Ok(Outcome { figures, prediction, renderings })
    }
}

/// A metric between a photograph and what should look like it.
///
/// # Errors
/// If the metric refuses the pair.
pub fn compare(
    metric: impl Fn(&Image, &Image) -> image_metrics::Result<f64>,
    view: &View,
    image: &Image,
) -> Result<f64> {
    metric(view.image(), image).map_err(|source| Error::Metric { view: view.name().to_owned(), source })
}

/// LPIPS between a photograph and its rendering, where there are weights for it.
///
/// # Errors
/// If the sizes of the two differ.
pub fn lpips_of(lpips: Option<&Lpips>, view: &View, image: &Image) -> Result<Option<f64>> {
    let distance =
        |lpips: &Lpips| compare(|photograph, image| lpips.distance(photograph, image), view, &clipped(image));
    lpips.map(distance).transpose()
}

/// Values clipped to 0..1, as a screen shows them; PSNR and SSIM clip by themselves.
fn clipped(image: &Image) -> Image {
    let mut clipped = image.clone();
    clipped.data_mut().iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
    clipped
}

/// The context view whose camera stands closest to the target's; of equals the first.
fn nearest_view<'a>(target: &View, context: &'a [View]) -> Result<&'a View> {
    let position = target.camera().position();
    let distance = |view: &View| view.camera().position().distance_squared(position);
    // `min_by` keeps the first of equals.
    context
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .ok_or_else(|| scene_windows::Error::NoContext.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_scene::{Camera, Intrinsics};

    fn view(name: &str, x: f64) -> View {
        let lens = Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 8.0, width: 16, height: 16 };
        // Cameras on a line, looking along z.
        let position = glam::DVec3::new(x, 0.0, 0.0);
        let camera = Camera::from_camera_to_world(lens, glam::DMat3::IDENTITY, position).unwrap();
        View::new(name, Image::filled(16, 16, [0.5; 3]).unwrap(), camera, None).unwrap()
    }

    #[test]
    fn the_nearest_view_is_the_first_of_equally_near_ones() {
        let context = [view("far", 9.0), view("left", -1.0), view("right", 1.0)];
        assert_eq!(nearest_view(&view("t", 0.0), &context).unwrap().name(), "left");
        assert_eq!(nearest_view(&view("t", 6.0), &context).unwrap().name(), "far");
        assert!(matches!(
            nearest_view(&view("t", 0.0), &[]),
            Err(Error::Window(scene_windows::Error::NoContext))
        ));
    }
}
