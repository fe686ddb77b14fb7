//! One point on one window with one seed.

use super::sweep::Point;
use evaluate::{
    Error, Method, Rendered, Result, Seconds, Step, Stopwatch, compare, lpips_of, mean, median,
    optional_mean, peak_rss_bytes, render_as, restart_peak_rss,
};
use gs_raster::{Rasterizer, RenderSettings};
use gs_scene::{Gaussians, write_ply};
use image_metrics::{Lpips, psnr, ssim};
use scene_windows::Window;
use serde::{Deserialize, Serialize};
use sparsesplat::{Geometry, Predictor, Stage};
use std::fs;
use std::path::Path;
use std::time::Instant;

/// How the figures are taken, in words.
pub const MEASURED_AS: &str = "\
Seconds are wall time from reading the first photograph to the written scene, without rendering. The backbone runs once per window \
and image size, and every point counts its time. All other stages run again for each point and seed. Seconds by stage are those of \
the seed with the median time, averaged over windows and scenes. Frames per second: the median over the held-out views of the time \
to render one picture and copy it to memory, after one untimed picture. Memory: the largest resident memory of the process while the \
point or its backbone ran, including photographs, cached depth and earlier allocations, without the memory of a GPU. File: the size \
of the PLY file, 32 bits per number. Points that do not depend on the seed (one Gaussian per pixel, merged, voxels) are measured \
with one seed.";

/// The views of a window, as tables state them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Views {
    /// Positions of the context views in the data set's list.
    pub context: Vec<usize>,
    /// Positions of the held-out targets.
    pub targets: Vec<usize>,
    /// Width and height of the first target, pixels; of the first context view without targets.
    pub size: (usize, usize),
    /// SHA-256 of the views: names, cameras, pictures.
    pub data_sha256: String,
}

impl Views {
    pub(super) fn of(window: &Window) -> Self {
        let first = window.targets.first().or_else(|| window.context.first());
        Self {
            context: window.context_positions.clone(),
            targets: window.target_positions.clone(),
            size: first.map_or((0, 0), |view| (view.image().width(), view.image().height())),
            data_sha256: window.sha256(),
        }
    }
}

/// What a point gave on a window with a seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// `scene/window`.
    pub window: String,
    /// Which views those are.
    #[serde(flatten)]
    pub views: Box<Views>,
    /// Seed of the sampling.
    pub seed: u64,
    /// Name of the point.
    pub point: String,
    /// Gaussians, far shell included.
    pub gaussians: usize,
    /// Mean PSNR over the held-out targets, dB; none without targets, or if a rendering is without error.
    pub psnr_held_out: Option<f64>,
    /// Mean SSIM over the held-out targets; none without targets.
    pub ssim_held_out: Option<f64>,
    /// Mean LPIPS over the held-out targets; none without targets or without weights.
    pub lpips_held_out: Option<f64>,
    /// Wall time by stage, the window's backbone included.
    pub seconds: Seconds,
    /// Median time of rendering one target, seconds; none without targets.
    pub seconds_per_frame: Option<f64>,
    /// Size of the written PLY, bytes.
    pub ply_bytes: u64,
    /// Most memory that the process held, bytes; none where the system does not count it anew.
    pub peak_rss_bytes: Option<u64>,
}

/// What the backbone says of a window, for all points that share it.
pub(super) struct Survey {
    geometry: Geometry,
    seconds: f64,
    peak_rss_bytes: Option<u64>,
}

impl Survey {
    pub(super) fn of(window: &Window, predictor: &Predictor, on_step: &mut dyn FnMut(Step)) -> Result<Self> {
        on_step(Step::Predict(Stage::Backbone));
        let counts = restart_peak_rss();
        let mut taken = Stopwatch::new();
        let geometry = taken.time(|| predictor.geometry(&window.context))?;
        let peak_rss_bytes = peak_rss_bytes().filter(|_| counts);
        Ok(Self { geometry, seconds: taken.seconds, peak_rss_bytes })
    }
}

/// What figures are taken with.
pub(super) struct Instruments<'a> {
    pub(super) rasterizer: &'a mut Rasterizer,
    pub(super) lpips: Option<&'a Lpips>,
    /// Scenes are written to this file, and the last is left there.
    pub(super) scratch: &'a Path,
}

/// Measures a point; `method` is the point's, with seed and depth range set, and `predictor` has its configuration.
pub(super) fn measure(
    window: &Window,
    views: &Views,
    survey: &Survey,
    point: &Point,
    method: &Method,
    predictor: &Predictor,
    instruments: &mut Instruments<'_>,
    on_step: &mut dyn FnMut(Step),
) -> Result<(Measured, Vec<Rendered>)> {
    let Instruments { rasterizer, lpips, scratch } = instruments;
    let (lpips, scratch) = (*lpips, *scratch);
    let counts = restart_peak_rss();
    let begin = Instant::now();
    let mut on_stage = |stage| on_step(Step::Predict(stage));
    let mut prediction = predictor.predict_from(&window.context, &survey.geometry, &mut on_stage)?;
    let mut refining = Stopwatch::new();
    let nothing = |_: &Gaussians, _: &mut Rasterizer| Ok(f64::NAN);
    if method.refine.is_some() {
        refining.time(|| method.refine(window, &mut prediction, rasterizer, &nothing, on_step))?;
    }
    let mut writing = Stopwatch::new();
    writing.time(|| write_ply(scratch, &prediction.gaussians))?;
    let after_backbone = begin.elapsed().as_secs_f64();
    let read = |source| gs_scene::Error::Io { action: "read", path: scratch.to_path_buf(), source };
    let ply_bytes = fs::metadata(scratch).map_err(read).map_err(Error::from)?.len();

    on_step(Step::Render);
    let settings = RenderSettings {
        alpha_min: point.cuts.alpha_min,
        transmittance_min: point.cuts.transmittance_min,
        ..RenderSettings::default()
    };
    let scene = &prediction.gaussians;
    if let Some(first) = window.targets.first() {
        render_as(rasterizer, scene, first.camera(), settings)?;
    }
    let (mut renderings, mut frames) = (Vec::new(), Vec::new());
    for target in &window.targets {
        let mut frame = Stopwatch::new();
        renderings.push(frame.time(|| render_as(rasterizer, scene, target.camera(), settings))?);
        frames.push(frame.seconds);
    }
    // Before the metrics, which are no part of the method.
    let own_peak = peak_rss_bytes().filter(|_| counts);
    let (mut psnrs, mut ssims, mut distances) = (Vec::new(), Vec::new(), Vec::new());
    for (target, rendered) in window.targets.iter().zip(&renderings) {
        psnrs.push(compare(psnr, target, &rendered.image)?);
        ssims.push(compare(ssim, target, &rendered.image)?);
        distances.push(lpips_of(lpips, target, &rendered.image)?);
    }
    let render: f64 = frames.iter().sum();
    let total = window.load_seconds + survey.seconds + after_backbone + render;
    let mut stages = prediction.seconds;
    stages[Stage::Backbone] = survey.seconds;
    let seconds = Seconds {
        poses: 0.0,
        load: window.load_seconds,
        stages,
        refine: refining.seconds,
        write: writing.seconds,
        render,
        total,
    };
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    let measured = Measured {
        window: window.name.clone(),
        views: Box::new(views.clone()),
        seed: method.predict.seed,
        point: point.label.point.clone(),
        gaussians: prediction.counts.total,
        psnr_held_out: finite(mean(psnrs.into_iter())),
        ssim_held_out: finite(mean(ssims.into_iter())),
        lpips_held_out: optional_mean(distances.into_iter()),
        seconds,
        seconds_per_frame: finite(median(frames.into_iter())),
        ply_bytes,
        peak_rss_bytes: own_peak.max(survey.peak_rss_bytes),
    };
    Ok((measured, renderings))
}
