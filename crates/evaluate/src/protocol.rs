//! The protocol of the tables: windows, seeds, means; what fails is named, never skipped.

use crate::figures::{MeanRow, WindowRow, means};
use crate::{Outcome, Runner, Step};
use gs_raster::Rasterizer;
use image_metrics::Lpips;
use scene_windows::{Dropped, Plan, Window, sha256_of};
use serde::Serialize;

/// What all tables have in common, in words.
pub const PROTOCOL: &str = "\
The whole image counts, without trimming a border, on a black background. Renderings are clipped to 0..1 and compared as floats with \
the 8-bit targets. Nothing is fitted to a target. PSNR is computed per target, then averaged over targets, windows and scenes. SSIM \
is scikit-image's structural_similarity with 11 Gaussian taps and sigma 1.5. The nearest view is the context photograph whose camera \
is closest, shown unchanged.";

/// What happens during an evaluation.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A run begins: a window with a seed.
    Run {
        /// Name of the window.
        name: &'a str,
        /// Seed of the run.
        seed: u64,
    },
    /// A step of the run begins.
    Step(Step),
    /// A run is done.
    Done {
        /// The window.
        window: &'a Window,
        /// What it gave.
        outcome: &'a Outcome,
    },
    /// A window is given up.
    Dropped(&'a Dropped),
}

/// The figures of an evaluation; with a recipe in front it is what `eval --json` writes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// How it was measured.
    pub protocol: &'static str,
    /// The network that LPIPS compares features of (`vgg`, the papers'; `alex`, `squeeze`): figures of different ones say
    /// nothing about each other. None where there were no weights: LPIPS was not measured.
    pub lpips_network: Option<&'static str>,
    /// One row per window.
    #[serde(rename = "scenes")]
    pub windows: Vec<WindowRow>,
    /// One row per scene: means over its windows.
    #[serde(rename = "by_scene")]
    pub scenes: Vec<MeanRow>,
    /// The mean over the scenes.
    pub mean: MeanRow,
    /// What the figures are to be compared with.
    pub baselines: Baselines,
    /// Windows without figures.
    pub dropped: Vec<Dropped>,
    /// SHA-256 of the windows' own, in their order: equal for equal data.
    pub data_sha256: String,
}

/// Figures of methods that do nothing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Baselines {
    /// The nearest context view, shown as it is.
    pub nearest_view: NearestView,
}

/// Mean figures of the nearest context view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NearestView {
    /// PSNR, dB.
    pub psnr_held_out: f64,
}

/// Runs every window with every seed. The method's own seed is not used; its depth range is replaced by a plan's where that
/// has one. LPIPS is measured where there are weights for it.
///
/// # Panics
/// If `seeds` is empty.
pub fn evaluate(
    plans: &[Plan],
    runner: &Runner,
    seeds: &[u64],
    lpips: Option<&Lpips>,
    rasterizer: &mut Rasterizer,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Evaluation {
    assert!(!seeds.is_empty(), "an evaluation needs at least one seed");
    let (mut windows, mut dropped) = (Vec::new(), Vec::new());
    for plan in plans {
        match run_plan(plan, runner, seeds, lpips, rasterizer, on_event) {
            Ok(row) => windows.push(row),
            Err(error) => {
                let entry = Dropped::new(plan.name(), &error);
                on_event(Event::Dropped(&entry));
                dropped.push(entry);
            }
        }
    }
    let (scenes, mean) = means(&windows);
    let nearest_view = NearestView { psnr_held_out: mean.figures.psnr_nearest_view };
    let data_sha256 = sha256_of(windows.iter().map(|window| window.data_sha256.as_str()));
    let baselines = Baselines { nearest_view };
    let lpips_network = lpips.map(|lpips| lpips.network().name());
    Evaluation { protocol: PROTOCOL, lpips_network, windows, scenes, mean, baselines, dropped, data_sha256 }
}

fn run_plan(
    plan: &Plan,
    runner: &Runner,
    seeds: &[u64],
    lpips: Option<&Lpips>,
    rasterizer: &mut Rasterizer,
    on_event: &mut dyn FnMut(Event<'_>),
) -> crate::Result<WindowRow> {
    on_event(Event::Run { name: plan.name(), seed: seeds[0] });
    on_event(Event::Step(Step::Load));
    let window = plan.load(true)?;
    let mut runs = Vec::with_capacity(seeds.len());
    for (i, &seed) in seeds.iter().enumerate() {
        if i > 0 {
            on_event(Event::Run { name: plan.name(), seed });
        }
        let runner = runner.with_method(runner.method().on(plan, seed))?;
        let outcome = runner.measure(&window, lpips, rasterizer, &mut |step| on_event(Event::Step(step)))?;
        on_event(Event::Done { window: &window, outcome: &outcome });
        runs.push(outcome.figures);
    }
    Ok(WindowRow::new(&window, runs))
}
