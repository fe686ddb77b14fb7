//! The method under evaluation, as settings: the pass, and optional refinement after it.

use crate::figures::CurvePoint;
use crate::render::render_view;
use crate::window::compare;
use crate::{Error, Result, Step};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians, Intrinsics, View};
use image_metrics::psnr;
use refine::Refined;
use scene_windows::{GeometryCache, Plan, Window};
use serde::Serialize;
use sparsesplat::learned::Corrector;
use sparsesplat::{Config, Prediction};
use std::time::Instant;

/// Photographs to Gaussians.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Method {
    /// The pass.
    #[serde(flatten)]
    pub predict: Config,
    /// Steps on the context views, after the looks of the pass and before its correction; none leaves the result of the pass.
    pub refine: Option<refine::Config>,
    /// Whether held-out views are measured while it is being refined, for a curve; outside the time that is
    /// measured. The curve then goes on to the last step: nothing stops early.
    pub curve: bool,
    /// Where what the backbone says is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cache: Option<GeometryCache>,
}

impl Method {
    /// The pass alone.
    #[must_use]
    pub fn feed_forward(predict: Config) -> Self {
        Self { predict, refine: None, curve: false, cache: None }
    }

    /// The pass up to its correction, then a refinement, then the correction.
    #[must_use]
    pub fn refined(predict: Config, refine: refine::Config) -> Self {
        Self { refine: Some(refine), ..Self::feed_forward(predict) }
    }

    /// The configuration of the pass: with a refinement it ends before its correction.
    #[must_use]
    pub fn pass(&self) -> Config {
        Config { refined_later: self.refine.is_some(), ..self.predict.clone() }
    }

    /// This method on a window: with its depth range where the plan has one, and with a seed.
    #[must_use]
    pub fn on(&self, plan: &Plan, seed: u64) -> Self {
        let mut method = self.clone();
        method.predict.seed = seed;
        method.predict.depth_range = plan.depth_range(method.predict.depth_range);
        if let Some(refine) = &mut method.refine {
            refine.seed = seed;
        }
        method
    }

    /// The scene of the pass without a refinement, corrected where the prediction leaves that to the refinement.
    pub(crate) fn passed(&self, window: &Window, prediction: &Prediction) -> Result<Gaussians> {
        let scene = prediction.gaussians.clone();
        let Some(corrector) = prediction.corrector.clone() else { return Ok(scene) };
        Ok(corrector.corrected(scene, &self.predict.exposure.views(&window.context, &prediction.exposure))?)
    }

    /// Refines a prediction in place, if that is asked for; `held_out` measures a scene, for the curve.
    ///
    /// # Errors
    /// If the scene cannot be refined, or `held_out` fails.
    pub fn refine(
        &self,
        window: &Window,
        prediction: &mut Prediction,
        rasterizer: &mut Rasterizer,
        held_out: &dyn Fn(&Gaussians, &mut Rasterizer) -> Result<f64>,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<Option<Refinement>> {
        let Some(mut config) = self.refine else { return Ok(None) };
        if self.curve {
            config.smallest_gain = 0.0;
        }
        // A correction needs all Gaussians in their order. They are pruned after it.
        let corrector = prediction.corrector.take();
        let prune = std::mem::replace(&mut config.prune, false);
        // In the exposure of the Gaussians.
        let mut exposed = self.predict.exposure.views(&window.context, &prediction.exposure).into_owned();
        config.exposure &= self.predict.exposure.is_fitted_by_view();
        let scene = std::mem::replace(&mut prediction.gaussians, Gaussians::empty(0)?);
        let mut curve = Vec::new();
        let mut problem = None;
        if self.curve {
            let psnr_held_out = held_out(&scene, rasterizer)?;
            curve.push(CurvePoint {
                step: 0,
                corrected: false,
                seconds: 0.0,
                psnr_context: f64::NAN,
                psnr_held_out,
            });
        }
        let mut refined = refine::refine(scene, &exposed, &config, rasterizer, &mut |step| {
            let record = step.record;
            on_step(Step::Refine { progress: step.progress, psnr_context: record.psnr_context });
            if self.curve && is_mark(record.step) {
                match held_out(step.gaussians, step.rasterizer) {
                    Ok(psnr_held_out) => curve.push(CurvePoint {
                        step: record.step,
                        corrected: false,
                        seconds: record.seconds,
                        psnr_context: record.psnr_context,
                        psnr_held_out,
                    }),
                    Err(error) => problem = Some(error),
                }
            }
        })
        .map_err(Error::Refine)?;
        if let Some(problem) = problem {
            return Err(problem);
        }
        if let Some(first) = curve.first_mut() {
            first.psnr_context = refined.report.psnr_start;
        }
        if let Some(last) = refined.report.steps.last()
            && self.curve
            && !is_mark(last.step)
        {
            curve.push(CurvePoint {
                step: last.step,
                corrected: false,
                seconds: last.seconds,
                psnr_context: last.psnr_context,
                psnr_held_out: held_out(&refined.gaussians, rasterizer)?,
            });
        }
        let corrected =
            corrector.map(|corrector| correct(corrector, &mut refined, &mut exposed)).transpose()?;
        if prune {
            let scene = std::mem::replace(&mut refined.gaussians, Gaussians::empty(0)?);
            (refined.gaussians, refined.report.pruned) = refine::prune(scene);
        }
        if self.curve && corrected.is_some() {
            let mut psnr_context = 0.0;
            for view in &exposed {
                let rendered = render_view(rasterizer, &refined.gaussians, view.camera())?;
                psnr_context += compare(psnr, view, &rendered.image)? / exposed.len() as f64;
            }
            curve.push(CurvePoint {
                step: refined.report.steps.len(),
                corrected: true,
                seconds: refined.report.seconds,
                psnr_context,
                psnr_held_out: held_out(&refined.gaussians, rasterizer)?,
            });
        }
        prediction.counts = prediction.counts.without(&refined.report.pruned);
        if let Some(corrected) = &corrected {
            prediction.corrected_by = Some(corrected.by.clone());
        }
        prediction.gaussians = refined.gaussians;
        Ok(Some(Refinement { report: refined.report, corrected, curve, cameras: refined.cameras }))
    }
}

/// Corrects a refined scene; its seconds count as the refinement's.
fn correct(corrector: Corrector, refined: &mut Refined, views: &mut [View]) -> Result<Corrected> {
    let begin = Instant::now();
    let by = corrector.name().to_owned();
    for (view, camera) in views.iter_mut().zip(&refined.cameras) {
        if view.camera() != camera {
            *view = View::new(view.name(), view.image().clone(), *camera, None)?;
        }
    }
    let scene = std::mem::replace(&mut refined.gaussians, Gaussians::empty(0)?);
    refined.gaussians = corrector.corrected(scene, views)?;
    let seconds = begin.elapsed().as_secs_f64();
    refined.report.seconds += seconds;
    Ok(Corrected { by, seconds })
}

/// What followed the steps of a refinement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Corrected {
    /// The corrector, as reports call it.
    pub by: String,
    /// Wall time, part of the refinement's.
    pub seconds: f64,
}

/// How a scene was refined.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Refinement {
    /// What happened.
    #[serde(flatten)]
    pub report: refine::Report,
    /// What corrected the scene after the steps, if anything did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corrected: Option<Corrected>,
    /// Quality along the way, with the cameras as they were given; empty if it was not asked for.
    pub curve: Vec<CurvePoint>,
    /// The camera of each context view afterwards.
    #[serde(skip)]
    pub cameras: Vec<Camera>,
}

impl Refinement {
    /// The camera of a view that took no part, with the focal length that was found for context views with the same intrinsics.
    #[must_use]
    pub fn camera(&self, view: &View, context: &[View]) -> Camera {
        let given = view.camera();
        let same = context.iter().position(|other| other.camera().intrinsics() == given.intrinsics());
        let Some(found) = same.and_then(|index| self.cameras.get(index)) else { return *given };
        let &Intrinsics { fx, fy, .. } = found.intrinsics();
        let lens = Intrinsics { fx, fy, ..*given.intrinsics() };
        Camera::new(lens, given.rotation(), given.translation()).unwrap_or(*given)
    }
}

/// Whether a step has a point on the curve: 1, 1.5, 2, 3, 4, 5, 6 and 7.5 times every power of ten.
fn is_mark(step: usize) -> bool {
    let mut decade = 1;
    while decade * 10 <= step {
        decade *= 10;
    }
    let halves = [2, 3, 4, 6, 8, 10, 12, 15];
    halves.iter().any(|half| half * decade == 2 * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_out_views_get_the_focal_length_of_their_lens() {
        let camera = |fx: f64, x: f64| {
            let lens = Intrinsics { fx, fy: 2.0 * fx, cx: 4.0, cy: 3.0, width: 8, height: 6 };
            Camera::new(lens, glam::DMat3::IDENTITY, glam::DVec3::new(x, 0.0, 0.0)).unwrap()
        };
        let view = |camera: Camera| {
            let image = gs_scene::Image::filled(8, 6, [0.5; 3]).unwrap();
            View::new("view", image, camera, None).unwrap()
        };
        let context = [view(camera(10.0, 0.0)), view(camera(20.0, 0.0))];
        let refinement = Refinement {
            report: refine::Report::default(),
            corrected: None,
            curve: Vec::new(),
            cameras: vec![camera(11.0, 0.1), camera(19.0, 0.1)],
        };
        for (given, found) in [(10.0, 11.0), (20.0, 19.0), (30.0, 30.0)] {
            assert_eq!(refinement.camera(&view(camera(given, 5.0)), &context), camera(found, 5.0));
        }
    }

    #[test]
    fn marks_are_dense_at_the_start() {
        let marks: Vec<usize> = (1..=100).filter(|&step| is_mark(step)).collect();
        assert_eq!(marks, [1, 2, 3, 4, 5, 6, 10, 15, 20, 30, 40, 50, 60, 75, 100]);
        assert!(is_mark(1000) && is_mark(200) && !is_mark(110));
    }
}
