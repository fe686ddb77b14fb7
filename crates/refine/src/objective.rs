//! The objective and its gradient: scene -> rendering -> exposure -> loss.

use crate::loss::{Compared, Target};
use crate::{Config, Exposure, Loss, Result};
use gs_raster::{Gradients, PixelGradients, Rasterizer, RenderSettings, near_plane};
use gs_scene::{Camera, Gaussians, View};
use image_metrics::SsimScratch;
use rayon::prelude::*;

/// How far a scene is from photographs, view by view.
#[derive(Debug)]
pub(crate) struct Objective<'a> {
    views: Vec<&'a View>,
    targets: Vec<Target<'a>>,
    loss: Loss,
    /// The near plane is that of the scene at the start: it must not move under the optimiser.
    settings: RenderSettings,
    /// For each view of a step.
    scratch: Vec<SsimScratch>,
}

/// A view as a step sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen {
    pub(crate) view: usize,
    /// Where its camera is now.
    pub(crate) camera: Camera,
    pub(crate) exposure: Exposure,
}

impl<'a> Objective<'a> {
    /// `low_pass` is the variance of the renderer's filter, square pixels of these views.
    pub(crate) fn new(scene: &Gaussians, views: Vec<&'a View>, config: &Config, low_pass: f32) -> Self {
        let &Config { loss, alpha_min, transmittance_min, .. } = config;
        let targets = views.par_iter().map(|view| Target::new(view, loss)).collect();
        let near = views.iter().map(|view| near_plane(scene, view.camera())).fold(f32::INFINITY, f32::min);
        let settings = RenderSettings {
            near,
            eps2d: low_pass,
            alpha_min,
            transmittance_min,
            ..RenderSettings::default()
        };
        Self { views, targets, loss, settings, scratch: Vec::new() }
    }

    /// Variance of the renderer's filter, square pixels.
    pub(crate) fn low_pass(&self) -> f32 {
        self.settings.eps2d
    }

    /// Exposure in which a view's photograph is closest to the scene as it is, and the PSNR without one; NaN
    /// if the rendering cannot be compared.
    pub(crate) fn look(
        &self,
        scene: &Gaussians,
        view: usize,
        rasterizer: &mut Rasterizer,
    ) -> Result<(Exposure, f64)> {
        let rendering = rasterizer.render(scene, self.views[view].camera(), &self.settings)?;
        Ok(self.targets[view].look(rendering.image.data()).unwrap_or((Exposure::NONE, f64::NAN)))
    }

    /// The camera of a view, as it was given.
    pub(crate) fn camera(&self, view: usize) -> &Camera {
        self.views[view].camera()
    }

    /// Renders views, compares them, and differentiates the mean of their losses by what is stored, into `gradients`; `None` if a picture
    /// is beyond comparison.
    pub(crate) fn differentiate(
        &mut self,
        scene: &Gaussians,
        seen: &[Seen],
        (rasterizer, gradients): (&mut Rasterizer, &mut Gradients),
    ) -> Result<Option<Vec<Compared>>> {
        let cameras: Vec<Camera> = seen.iter().map(|seen| seen.camera).collect();
        let (renderings, tape) = rasterizer.record(scene, &cameras, &self.settings)?;
        let (loss, weight) = (self.loss, 1.0 / seen.len() as f32);
        self.scratch.resize_with(seen.len(), SsimScratch::default);
        let pictures = seen.par_iter().zip(&renderings).zip(&mut self.scratch);
        let compared = pictures.map(|((&Seen { view, exposure, .. }, rendering), scratch)| {
            self.targets[view].compare(rendering.image.data(), exposure, loss, weight, scratch)
        });
        let Some(mut compared) = compared.collect::<Option<Vec<_>>>() else { return Ok(None) };
        let by_pixels = |compared: &mut Compared| {
            let image = std::mem::take(&mut compared.by_rendering);
            PixelGradients { image: image.into(), alpha: None, depth: None }
        };
        let pixels: Vec<_> = compared.iter_mut().map(by_pixels).collect();
        rasterizer.backward_into(scene, &tape, &pixels, gradients)?;
        Ok(Some(compared))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ColourTerm;
    use crate::scenes::{cameras, disturbed, photographs, wall};
    use std::ops::Range;

    /// Derivatives of the mean loss of all views against central differences along the derivative itself,
    /// where the slope is largest and the rounding of the loss smallest against it.
    fn check(loss: Loss, exposure: Exposure) {
        let truth = wall(6, 1.0);
        let views = photographs(&truth, &cameras(2, (40, 32), 1.0));
        let scene = disturbed(&truth, 1.0);
        let mut rasterizer = Rasterizer::cpu();
        let config = Config { loss, ..Config::default() };
        let mut objective = Objective::new(&scene, views.iter().collect(), &config, 0.3);
        let seen = |(view, of_view): (usize, &View)| Seen { view, camera: *of_view.camera(), exposure };
        let seen: Vec<Seen> = views.iter().enumerate().map(seen).collect();
        let mut evaluate = |scene: &Gaussians| {
            let mut gradients = Gradients::default();
            let into = (&mut rasterizer, &mut gradients);
            let compared = objective.differentiate(scene, &seen, into).unwrap().unwrap();
            let value = compared.iter().map(|compared| compared.loss).sum::<f64>() / seen.len() as f64;
            let [geometry, sh] = [gradients.geometry, gradients.sh]
                .map(|numbers| numbers.into_iter().map(f64::from).collect::<Vec<f64>>());
            (value, geometry, sh)
        };
        let (_, geometry, sh) = evaluate(&scene);
        let colours = 11..14;
        let groups: [(&str, Range<usize>, f64); 5] = [
            ("mean", gs_scene::MEAN, 1e-3),
            ("rotation", gs_scene::QUATERNION, 4e-3),
            ("scale", gs_scene::LOG_SCALE, 4e-3),
            ("opacity", 10..11, 2e-2),
            ("colour", colours.clone(), 1e-2),
        ];
        for (name, columns, step) in groups {
            let of_colour = columns == colours;
            let (all, width) = if of_colour { (&sh, 3) } else { (&geometry, Gaussians::GEOMETRY) };
            let chosen = |i: usize| of_colour || columns.contains(&(i % width));
            let direction: Vec<f64> =
                all.iter().enumerate().map(|(i, g)| if chosen(i) { *g } else { 0.0 }).collect();
            let square = direction.iter().map(|d| d * d).sum::<f64>();
            let largest = direction.iter().fold(0.0f64, |a, b| a.max(b.abs()));
            assert!(largest > 0.0, "{name}: no derivative at all");
            let mut value = |by: f64| {
                let mut moved = scene.clone();
                let (geometry, sh) = moved.buffers_mut();
                let numbers = if of_colour { sh } else { geometry };
                numbers.iter_mut().zip(&direction).for_each(|(v, d)| *v += (by * d / largest) as f32);
                evaluate(&moved).0
            };
            let slope = (value(step) - value(-step)) / (2.0 * step);
            let expected = square / largest;
            assert!((slope / expected - 1.0).abs() < 0.02, "{name}: {slope:e} by differences, {expected:e}");
        }
    }

    #[test]
    fn derivatives_by_all_that_is_stored_are_those_of_the_loss() {
        for (colour, dssim) in [(ColourTerm::Mse, 0.0), (ColourTerm::Mse, 0.3), (ColourTerm::L1, 0.2)] {
            check(Loss { colour, dssim }, Exposure::NONE);
        }
        check(Loss::default(), Exposure { gain: 0.8, bias: 0.05 });
    }
}
