//! The figures of a window, and their means: over targets, then windows, then scenes.

use crate::method::Refinement;
use scene_windows::{Window, scene_of};
use serde::{Deserialize, Serialize, Serializer};
use sparsesplat::{Counts, ExposureGain, Stage, StageSeconds};

/// Wall time, seconds, by stage. A stage that did not run took 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Estimating the poses of the photographs, where that was asked for.
    #[serde(default)]
    pub poses: f64,
    /// Reading, undistorting and resizing photographs; of `reconstruct` also reading weights. Where several windows are run, weights are
    /// read once before them, in no window's time.
    pub load: f64,
    /// The stages of the pass.
    #[serde(flatten)]
    pub stages: StageSeconds,
    /// Refinement: its steps, and the correction after them, which is then no stage of the pass.
    pub refine: f64,
    /// Writing the scene.
    pub write: f64,
    /// Rendering, all pictures together.
    pub render: f64,
    /// From the first file read to the last of the above, what lies between the stages included; not the metrics.
    pub total: f64,
}

impl Seconds {
    /// Name and time of each stage in order, without the total.
    pub fn by_name(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let pass = Stage::ALL.map(|stage| (stage.name(), self.stages[stage]));
        let after = [("refine", self.refine), ("write", self.write), ("render", self.render)];
        [("poses", self.poses), ("load", self.load)].into_iter().chain(pass).chain(after)
    }

    fn mean(all: &[Self]) -> Self {
        Self::of_each(|value| mean(all.iter().map(value)))
    }

    /// Every time from the way to read it off.
    pub fn of_each(value: impl Fn(&dyn Fn(&Self) -> f64) -> f64) -> Self {
        Self {
            poses: value(&|s| s.poses),
            load: value(&|s| s.load),
            stages: StageSeconds::of_each(|stage| value(&|s| s.stages[stage])),
            refine: value(&|s| s.refine),
            write: value(&|s| s.write),
            render: value(&|s| s.render),
            total: value(&|s| s.total),
        }
    }

    /// From photographs to Gaussians: the total without rendering.
    #[must_use]
    pub fn to_gaussians(&self) -> f64 {
        self.total - self.render
    }
}

/// What is averaged: the figures of a window, of a scene or of a table. PSNR in dB; NaN where there is no target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// Gaussians, far shell included.
    #[serde(serialize_with = "as_count")]
    pub gaussians: f64,
    /// Those of the far shell.
    #[serde(serialize_with = "as_count")]
    pub gaussians_shell: f64,
    /// Mean PSNR over the held-out targets.
    pub psnr_held_out: f64,
    /// Mean SSIM over the held-out targets.
    pub ssim_held_out: f64,
    /// Mean LPIPS over the held-out targets, by [`crate::Evaluation::lpips_network`]; none without its weights.
    pub lpips_held_out: Option<f64>,
    /// `psnr_held_out` after a gain and bias per channel that are fitted to the target: what is left when exposure is no error. In no
    /// table: all else here is fitted to nothing.
    pub psnr_colour_corrected: f64,
    /// Mean over the held-out targets of the share of the squared error that the worst tenth of the pixels holds, 0..1.
    pub error_in_worst_tenth: f64,
    /// Mean PSNR over the held-out targets and the context views.
    pub psnr_all: f64,
    /// Mean PSNR of the nearest context view, shown as it is, over the held-out targets.
    pub psnr_nearest_view: f64,
    /// `psnr_held_out` of the pass without the refinement; NaN where there was none.
    pub psnr_held_out_feed_forward: f64,
    /// `ssim_held_out` of the pass without the refinement; NaN where there was none.
    pub ssim_held_out_feed_forward: f64,
    /// Wall time by stage.
    pub seconds: Seconds,
}

/// A mean of counts in JSON: a whole number.
fn as_count<S: Serializer>(count: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u64(count.round() as u64)
}

impl Figures {
    /// The mean of each figure; of nothing it is NaN.
    #[must_use]
    pub fn mean(all: &[Self]) -> Self {
        let mean = |value: fn(&Self) -> f64| mean(all.iter().map(value));
        Self {
            gaussians: mean(|f| f.gaussians),
            gaussians_shell: mean(|f| f.gaussians_shell),
            psnr_held_out: mean(|f| f.psnr_held_out),
            ssim_held_out: mean(|f| f.ssim_held_out),
            lpips_held_out: optional_mean(all.iter().map(|f| f.lpips_held_out)),
            psnr_colour_corrected: mean(|f| f.psnr_colour_corrected),
            error_in_worst_tenth: mean(|f| f.error_in_worst_tenth),
            psnr_all: mean(|f| f.psnr_all),
            psnr_nearest_view: mean(|f| f.psnr_nearest_view),
            psnr_held_out_feed_forward: mean(|f| f.psnr_held_out_feed_forward),
            ssim_held_out_feed_forward: mean(|f| f.ssim_held_out_feed_forward),
            seconds: Seconds::mean(&all.iter().map(|f| f.seconds).collect::<Vec<_>>()),
        }
    }
}

/// Mean; NaN of nothing. An infinity stays one.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count)
}

/// Mean where every value is there; none of nothing.
pub fn optional_mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values: Vec<f64> = values.collect::<Option<_>>()?;
    (!values.is_empty()).then(|| mean(values.into_iter()))
}

/// Median, of an even number the mean of the two in the middle; NaN of nothing. An infinity stays one.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    mean([sorted[last / 2], sorted[last.div_ceil(2)]].into_iter())
}

/// Standard deviation of a sample; `None` with fewer than two values.
#[must_use]
pub fn deviation(values: &[f64]) -> Option<f64> {
    let centre = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// How one target was met.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// Name of the view.
    pub name: String,
    /// PSNR, dB.
    pub psnr: f64,
    /// SSIM.
    pub ssim: f64,
    /// LPIPS; none without its weights.
    pub lpips: Option<f64>,
    /// PSNR after a gain and bias per channel that are fitted to the target, dB.
    pub psnr_colour_corrected: f64,
    /// Share of the squared error that the worst tenth of the pixels holds, 0..1: high where a few surfaces are wrong, low where everything
    /// is a little off.
    pub error_in_worst_tenth: f64,
    /// PSNR of the pass without the refinement, dB; none if there was none.
    pub psnr_feed_forward: Option<f64>,
    /// Name of the nearest context view.
    pub nearest_view: String,
    /// PSNR of that view shown as it is, dB.
    pub psnr_nearest_view: f64,
}

/// The figures of one window with one seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WindowFigures {
    /// Seed of the sampling.
    pub seed: u64,
    /// What is averaged.
    #[serde(flatten)]
    pub figures: Figures,
    /// Gaussians by origin.
    pub counts: Counts,
    /// The paper's tau that the budget was solved to.
    pub tau: Option<f64>,
    /// Near and far plane, scene units.
    pub depth_range: (f64, f64),
    /// Gain and bias of each context view.
    pub exposure: Vec<ExposureGain>,
    /// What corrected the scene, if anything did.
    pub corrected_by: Option<String>,
    /// What refinement did, where there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
    /// Every held-out target.
    pub per_target: Vec<Target>,
}

/// Quality at one moment of a refinement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Steps done.
    pub step: usize,
    /// Whether the scene was corrected after them.
    pub corrected: bool,
    /// Time that all of it took.
    pub seconds: f64,
    /// Mean PSNR over the context views, dB; of each the newest that is known. Of a corrected scene it is measured with all exposures as they are.
    pub psnr_context: f64,
    /// Mean PSNR over the held-out targets, dB.
    pub psnr_held_out: f64,
}

/// Spread over seeds: standard deviation of the sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Of the PSNR, dB.
    pub psnr_held_out: f64,
    /// Of the SSIM.
    pub ssim_held_out: f64,
}

impl Spread {
    fn of(all: &[Figures]) -> Option<Self> {
        let deviation = |value: fn(&Figures) -> f64| deviation(&all.iter().map(value).collect::<Vec<_>>());
        Some(Self {
            psnr_held_out: deviation(|f| f.psnr_held_out)?,
            ssim_held_out: deviation(|f| f.ssim_held_out)?,
        })
    }
}

/// A window with all its seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WindowRow {
    /// `scene/window`.
    pub name: String,
    /// Number of context views.
    pub views: usize,
    /// Positions of the context views in the data set's list.
    pub context: Vec<usize>,
    /// Positions of the held-out targets.
    pub targets: Vec<usize>,
    /// SHA-256 of the views: names, cameras, pictures.
    pub data_sha256: String,
    /// Mean over the seeds.
    #[serde(flatten)]
    pub figures: Figures,
    /// Spread over the seeds, where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread: Option<Spread>,
    /// One entry per seed.
    pub seeds: Vec<WindowFigures>,
}

impl WindowRow {
    /// A window's row from its runs, one per seed.
    #[must_use]
    pub fn new(window: &Window, seeds: Vec<WindowFigures>) -> Self {
        let all: Vec<Figures> = seeds.iter().map(|run| run.figures).collect();
        let (figures, spread) = (Figures::mean(&all), Spread::of(&all));
        Self {
            name: window.name.clone(),
            views: window.context.len(),
            context: window.context_positions.clone(),
            targets: window.target_positions.clone(),
            data_sha256: window.sha256(),
            figures,
            spread,
            seeds,
        }
    }

    /// The scene: the name before the last slash.
    #[must_use]
    pub fn scene(&self) -> &str {
        scene_of(&self.name)
    }
}

/// A scene or the whole table: means of what lies below it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeanRow {
    /// Name of the scene, or `mean`.
    pub name: String,
    /// Windows (of a scene) or scenes (of a table) that went into it.
    pub members: usize,
    /// Mean over seeds and members.
    #[serde(flatten)]
    pub figures: Figures,
    /// Spread of the mean over the seeds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread: Option<Spread>,
}

/// The rows of scenes, and of the mean over them.
///
/// # Panics
/// If the windows have not all the same number of seeds.
#[must_use]
pub fn means(windows: &[WindowRow]) -> (Vec<MeanRow>, MeanRow) {
    let n_seeds = windows.first().map_or(0, |window| window.seeds.len());
    assert!(
        windows.iter().all(|window| window.seeds.len() == n_seeds),
        "every window is run with every seed"
    );
    let mut names: Vec<&str> = Vec::new();
    for window in windows {
        if !names.contains(&window.scene()) {
            names.push(window.scene());
        }
    }
    let row = |name: &str, members: usize, per_seed: Vec<Figures>| MeanRow {
        name: name.to_owned(),
        members,
        figures: Figures::mean(&per_seed),
        spread: Spread::of(&per_seed),
    };
    let mut scenes = Vec::new();
    let mut scene_figures: Vec<Vec<Figures>> = vec![Vec::new(); n_seeds];
    for name in names {
        let of_scene: Vec<&WindowRow> = windows.iter().filter(|window| window.scene() == name).collect();
        let per_seed: Vec<Figures> = (0..n_seeds)
            .map(|s| Figures::mean(&of_scene.iter().map(|w| w.seeds[s].figures).collect::<Vec<_>>()))
            .collect();
        for (all, figures) in scene_figures.iter_mut().zip(&per_seed) {
            all.push(*figures);
        }
        scenes.push(row(name, of_scene.len(), per_seed));
    }
    let per_seed = scene_figures.iter().map(|all| Figures::mean(all)).collect();
    let mean = row("mean", scenes.len(), per_seed);
    (scenes, mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(psnr: f64) -> Figures {
        Figures { psnr_held_out: psnr, ..Figures::mean(&[]) }
    }

    fn row(name: &str, psnrs: &[f64]) -> WindowRow {
        let run = |(seed, &psnr): (usize, &f64)| WindowFigures {
            seed: seed as u64,
            figures: figures(psnr),
            counts: Counts { total: 0, per_view: vec![], shell: 0 },
            tau: None,
            depth_range: (1.0, 2.0),
            exposure: vec![],
            corrected_by: None,
            refinement: None,
            per_target: vec![],
        };
        let seeds = psnrs.iter().enumerate().map(run).collect();
        let window = Window {
            name: name.to_owned(),
            context: Vec::new(),
            targets: Vec::new(),
            context_positions: vec![0, 2],
            target_positions: vec![1],
            load_seconds: 0.0,
        };
        WindowRow::new(&window, seeds)
    }

    #[test]
    fn scenes_weigh_alike_however_many_windows_they_have() {
        let windows = [row("a/0", &[10.0]), row("a/1", &[20.0]), row("b/0", &[30.0])];
        let (scenes, mean) = means(&windows);
        assert_eq!(
            scenes.iter().map(|s| (s.name.as_str(), s.members)).collect::<Vec<_>>(),
            [("a", 2), ("b", 1)]
        );
        assert_eq!(scenes[0].figures.psnr_held_out, 15.0);
        assert_eq!(mean.figures.psnr_held_out, 22.5);
        assert_eq!(mean.spread, None);
    }

    #[test]
    fn the_spread_of_a_mean_is_over_seeds_not_over_windows() {
        let windows = [row("a/0", &[10.0, 12.0]), row("b/0", &[30.0, 28.0])];
        let (scenes, mean) = means(&windows);
        assert!((scenes[0].spread.unwrap().psnr_held_out - 2.0f64.sqrt()).abs() < 1e-12);
        assert_eq!(mean.figures.psnr_held_out, 20.0);
        assert_eq!(mean.spread.unwrap().psnr_held_out, 0.0);
    }

    #[test]
    fn nothing_has_no_mean_and_undefined_figures_are_null() {
        let (scenes, mean) = means(&[]);
        assert!(scenes.is_empty() && mean.figures.psnr_held_out.is_nan());
        let json = serde_json::to_value(&mean).unwrap();
        assert!(json["psnr_held_out"].is_null() && json["lpips_held_out"].is_null());
        let perfect = serde_json::to_value(figures(f64::INFINITY)).unwrap();
        assert!(perfect["psnr_held_out"].is_null());
    }

    #[test]
    fn a_median_lies_in_the_middle() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), 2.0);
        assert_eq!(median([4.0, 1.0, 2.0, 3.0].into_iter()), 2.5);
        assert_eq!(median([f64::INFINITY].into_iter()), f64::INFINITY);
        assert!(median(std::iter::empty()).is_nan());
    }

    #[test]
    fn stages_add_up_to_the_fields() {
        let stages = StageSeconds::of_each(|stage| 2.0 + f64::from(u8::from(stage == Stage::Decode)));
        let seconds = Seconds { load: 1.0, stages, render: 8.0, total: 99.0, ..Default::default() };
        assert_eq!(seconds.by_name().map(|(_, s)| s).sum::<f64>(), 10.0 + 2.0 * Stage::ALL.len() as f64);
        let json = serde_json::to_value(seconds).unwrap();
        assert_eq!(json.as_object().unwrap().len(), seconds.by_name().count() + 1);
        for (name, value) in seconds.by_name() {
            assert_eq!(json[name], value);
        }
        assert_eq!(serde_json::from_value::<Seconds>(json).unwrap(), seconds);
    }
}
