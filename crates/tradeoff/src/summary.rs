//! The summary of a sweep: a row per point, fronts, knees and shares.

use super::front::{Knee, knee, pareto_front};
use super::journal::{Entry, Failed, Header};
use super::measure::{MEASURED_AS, Measured, Views};
use super::share::{Reached, reaches};
use super::sweep::{Axis, Label};
use evaluate::{PROTOCOL, Seconds, Spread, deviation, mean, median};
use scene_windows::{Dropped, scene_of, sha256_of};
use serde::Serialize;

/// The figures of a point: means over windows, then scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// What the point is.
    #[serde(flatten)]
    pub label: Label,
    /// Gaussians, far shell included.
    pub gaussians: f64,
    /// PSNR of held-out targets, dB; NaN where there is none.
    pub psnr_held_out: f64,
    /// SSIM of held-out targets.
    pub ssim_held_out: f64,
    /// LPIPS of held-out targets, by [`Summary::lpips_network`]; none without its weights.
    pub lpips_held_out: Option<f64>,
    /// Spread over the seeds, where there are several.
    pub spread: Option<Spread>,
    /// Wall time by stage, of the seed whose pass took the median time.
    pub seconds: Seconds,
    /// From photographs to Gaussians, seconds: the median over the seeds.
    pub seconds_to_gaussians: f64,
    /// Frames per second on the device that was used.
    pub frames_per_second: f64,
    /// Size of the written PLY, bytes.
    pub ply_bytes: f64,
    /// Most memory of the process over all windows and seeds, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Whether no rival has more quality in less time.
    pub on_front_of_seconds: bool,
    /// Whether no rival has more quality with fewer Gaussians.
    pub on_front_of_gaussians: bool,
    /// Whether it is on one of these fronts.
    pub pareto: bool,
    /// Why there are no figures.
    pub failed: Option<String>,
}

/// How many Gaussians an allocation needs for what one per pixel gives.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Share {
    /// The curve: its allocation, and its head where that is not the base's.
    pub curve: String,
    /// The pixel-aligned PSNR with the same head, dB.
    pub aligned: f64,
    /// Where it reaches the pixel-aligned PSNR.
    #[serde(flatten)]
    pub reached: Reached,
    /// That count over the pixel-aligned count, 0 to 1; none where it is not reached.
    pub share: Option<f64>,
    /// The paper's share, for DL3DV and its trained head.
    pub paper: Option<f64>,
}

/// The paper's share for entropy sampling: "only approximately 22 % of the Gaussian primitives".
const PAPER_SHARE: (&str, f64) = ("entropy", 0.22);

/// Everything that a sweep found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// How quality was measured.
    pub protocol: &'static str,
    /// How the rest was.
    pub measured_as: &'static str,
    /// Windows that are in the means.
    pub windows: Vec<String>,
    /// The views of these.
    pub views: Vec<Views>,
    /// The network that LPIPS compares features of; none without weights: LPIPS was not measured.
    pub lpips_network: Option<String>,
    /// SHA-256 of the windows' own, in their order: equal for equal data.
    pub data_sha256: String,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// One row per point.
    #[serde(rename = "rows")]
    pub points: Vec<Row>,
    /// Where quality over seconds bends, along the budget.
    pub knee_of_seconds: Option<Knee>,
    /// Where quality over Gaussians bends, along the budget.
    pub knee_of_gaussians: Option<Knee>,
    /// What each allocation needs for the pixel-aligned PSNR.
    pub shares: Vec<Share>,
    /// Windows and scenes that are in no mean, and points without figures.
    pub dropped: Vec<Dropped>,
}

impl Summary {
    /// Of everything that was measured.
    #[must_use]
    pub fn new(header: &Header, entries: &[Entry]) -> Self {
        let found = Entries::new(header, entries);
        let mut dropped = header.dropped.clone();
        dropped.extend(found.dropped.iter().cloned());
        let mut points: Vec<Row> = header.points.iter().map(|label| found.row(label)).collect();
        for row in &points {
            if let Some(reason) = row.failed.clone().filter(|_| !found.windows.is_empty()) {
                dropped.push(Dropped { name: row.label.point.clone(), reason, failed: true });
            }
        }
        let seconds = |row: &Row| row.seconds_to_gaussians;
        let gaussians = |row: &Row| row.gaussians;
        let by_seconds = front(&points, Axis::competes, seconds);
        let by_gaussians = front(&points, Axis::competes, gaussians);
        by_seconds.iter().for_each(|&i| points[i].on_front_of_seconds = true);
        by_gaussians.iter().for_each(|&i| points[i].on_front_of_gaussians = true);
        points.iter_mut().for_each(|row| row.pareto = row.on_front_of_seconds || row.on_front_of_gaussians);
        let views: Vec<Views> =
            found.windows.iter().filter_map(|window| found.views(window)).cloned().collect();
        Self {
            protocol: PROTOCOL,
            measured_as: MEASURED_AS,
            windows: found.windows.iter().map(|&window| window.to_owned()).collect(),
            data_sha256: sha256_of(views.iter().map(|views| views.data_sha256.as_str())),
            views,
            lpips_network: header.lpips_network.clone(),
            seeds: header.seeds.clone(),
            knee_of_seconds: knee_of(&points, seconds),
            knee_of_gaussians: knee_of(&points, gaussians),
            shares: shares(&points),
            points,
            dropped,
        }
    }

    /// The point with one Gaussian per pixel, if it has figures.
    #[must_use]
    pub fn pixel_aligned(&self) -> Option<&Row> {
        pixel_aligned(&self.points, Axis::Budget)
    }

    /// The point of an allocation with a count, or without one where there is one Gaussian per pixel; with the base's head.
    #[must_use]
    pub fn by_count(&self, allocation: &str, count: Option<usize>) -> Option<&Row> {
        let is_it = |row: &&Row| {
            let label = &row.label;
            label.is_of_counts()
                && label.axis != Axis::Head
                && label.allocation == allocation
                && label.count == count
        };
        self.points.iter().filter(|row| row.failed.is_none()).find(is_it)
    }

    /// Curves over the count by name, their points in order of the count; the base's first.
    #[must_use]
    pub fn curves(&self) -> Vec<(String, Vec<&Row>)> {
        curves(&self.points)
    }

    /// How many windows, scenes or points failed.
    #[must_use]
    pub fn failures(&self) -> usize {
        self.dropped.iter().filter(|dropped| dropped.failed).count()
    }
}

const PIXEL_ALIGNED: &str = "pixel-aligned";
const CLOSED_FORM: &str = "closed-form-";
const CLOSED_FORM_PIXEL_ALIGNED: &str = "closed-form-pixel-aligned";

/// The times of the run whose pass took the median time; of an even number the shorter.
fn median_run<'a>(runs: &[&'a Measured]) -> &'a Seconds {
    let mut sorted: Vec<&Seconds> = runs.iter().map(|run| &run.seconds).collect();
    sorted.sort_by(|a, b| a.to_gaussians().total_cmp(&b.to_gaussians()));
    sorted[(sorted.len() - 1) / 2]
}

/// One per pixel, of the budget or of the closed form.
fn pixel_aligned(points: &[Row], axis: Axis) -> Option<&Row> {
    let row = points.iter().find(|row| {
        // Another network's own Gaussians are on the axis of the heads as well.
        let named = axis != Axis::Head || row.label.point == CLOSED_FORM_PIXEL_ALIGNED;
        row.label.allocation == PIXEL_ALIGNED && row.label.axis == axis && named
    });
    row.filter(|row| row.failed.is_none())
}

fn curves(points: &[Row]) -> Vec<(String, Vec<&Row>)> {
    let mut curves: Vec<(String, Vec<&Row>)> = Vec::new();
    for row in points.iter().filter(|row| row.failed.is_none()) {
        let Some(curve) = row.label.curve() else { continue };
        match curves.iter_mut().find(|(name, _)| *name == curve) {
            Some((_, rows)) => rows.push(row),
            None => curves.push((curve, vec![row])),
        }
    }
    curves.iter_mut().for_each(|(_, rows)| rows.sort_by(|a, b| a.gaussians.total_cmp(&b.gaussians)));
    curves
}

/// Positions of the points on the front of PSNR over a cost, among those of some axes.
fn front(points: &[Row], competes: fn(Axis) -> bool, cost: fn(&Row) -> f64) -> Vec<usize> {
    let rivals: Vec<usize> = (0..points.len()).filter(|&i| competes(points[i].label.axis)).collect();
    let values: Vec<(f64, f64)> =
        rivals.iter().map(|&i| (cost(&points[i]), points[i].psnr_held_out)).collect();
    pareto_front(&values).into_iter().map(|i| rivals[i]).collect()
}

/// The knee of the budget: of the front that its points alone make.
fn knee_of(points: &[Row], cost: fn(&Row) -> f64) -> Option<Knee> {
    let front = front(points, |axis| axis == Axis::Budget, cost);
    let values: Vec<(f64, f64)> =
        front.iter().map(|&i| (cost(&points[i]), points[i].psnr_held_out)).collect();
    let (knee, best) = (&points[front[knee(&values)?]], &points[*front.last()?]);
    let saved = cost(best) - cost(knee);
    Some(Knee {
        point: knee.label.point.clone(),
        best: best.label.point.clone(),
        decibels: best.psnr_held_out - knee.psnr_held_out,
        saved,
        share: saved / cost(best),
    })
}

fn shares(points: &[Row]) -> Vec<Share> {
    let curve_share = |(name, rows): (String, Vec<&Row>)| {
        // With the same head: else heads would be compared, not allocations. Of the others only the closed form has one per pixel.
        let label = &rows[0].label;
        let is_comparable = label.axis != Axis::Head || label.point.starts_with(CLOSED_FORM);
        let axis = if label.axis == Axis::Head { Axis::Head } else { Axis::Budget };
        let aligned = pixel_aligned(points, axis).filter(|_| is_comparable)?;
        let curve: Vec<(f64, f64)> = rows.iter().map(|row| (row.gaussians, row.psnr_held_out)).collect();
        let reached = reaches(&curve, aligned.psnr_held_out);
        let share = match reached {
            Reached::At { gaussians } | Reached::AtOnce { gaussians } => Some(gaussians / aligned.gaussians),
            Reached::Never => None,
        };
        let paper = (name == PAPER_SHARE.0).then_some(PAPER_SHARE.1);
        Some(Share { curve: name, aligned: aligned.psnr_held_out, reached, share, paper })
    };
    curves(points).into_iter().filter_map(curve_share).collect()
}

/// Entries by window, point and seed.
struct Entries<'a> {
    seeds: &'a [u64],
    /// Those with figures, in the order of the sweep.
    windows: Vec<&'a str>,
    measured: Vec<&'a Measured>,
    failed: Vec<&'a Failed>,
    dropped: Vec<Dropped>,
}

impl<'a> Entries<'a> {
    fn new(header: &'a Header, entries: &'a [Entry]) -> Self {
        let (mut measured, mut failed) = (Vec::new(), Vec::new());
        for entry in entries {
            match entry {
                Entry::Measured(entry) => measured.push(entry),
                Entry::Failed(entry) => failed.push(entry),
            }
        }
        let mut found = Self { seeds: &header.seeds, windows: vec![], measured, failed, dropped: vec![] };
        let has_figures = |window: &str| {
            found.measured.iter().any(|entry| entry.window == window && entry.psnr_held_out.is_some())
        };
        let reason = |window: &str| match found.failed.iter().find(|failed| failed.window == window) {
            Some(failed) => failed.reason.clone(),
            None => "no held-out views to measure on".to_owned(),
        };
        let (mut windows, mut dropped) = (Vec::new(), Vec::new());
        for window in header.windows.iter().map(String::as_str) {
            if has_figures(window) {
                windows.push(window);
            } else {
                dropped.push(Dropped { name: window.to_owned(), reason: reason(window), failed: true });
            }
        }
        (found.windows, found.dropped) = (windows, dropped);
        found
    }

    /// What a point gave on a window with a seed; the last of several.
    fn find(&self, window: &str, point: &str, seed: u64) -> Option<&'a Measured> {
        let is_it = |entry: &&&Measured| entry.window == window && entry.point == point && entry.seed == seed;
        self.measured.iter().rfind(is_it).copied()
    }

    fn views(&self, window: &str) -> Option<&'a Views> {
        self.measured.iter().find(|entry| entry.window == window).map(|entry| entry.views.as_ref())
    }

    fn row(&self, label: &Label) -> Row {
        let seeds = label.seeds(self.seeds);
        let runs: Vec<Vec<Option<&Measured>>> = self
            .windows
            .iter()
            .map(|window| seeds.iter().map(|&seed| self.find(window, &label.point, seed)).collect())
            .collect();
        let complete: Option<Vec<Vec<&Measured>>> =
            runs.into_iter().map(|seeds| seeds.into_iter().collect()).collect();
        let (runs, failed) = match complete {
            Some(runs) if !runs.is_empty() => (runs, None),
            Some(runs) => (runs, Some("no window has figures".to_owned())),
            None => (Vec::new(), Some(self.why_not(&label.point))),
        };
        // Of each window one number, of each scene their mean, of these the mean.
        let over_scenes = |value: &dyn Fn(&[&Measured]) -> f64| {
            let mut scenes: Vec<(&str, Vec<f64>)> = Vec::new();
            for (window, runs) in self.windows.iter().zip(&runs) {
                let scene = scene_of(window);
                match scenes.iter_mut().find(|(name, _)| *name == scene) {
                    Some((_, values)) => values.push(value(runs)),
                    None => scenes.push((scene, vec![value(runs)])),
                }
            }
            mean(scenes.into_iter().map(|(_, values)| mean(values.into_iter())))
        };
        let per_seed = |value: fn(&Measured) -> Option<f64>| -> Vec<f64> {
            let of_seed = |i: usize| over_scenes(&|runs| value(runs[i]).unwrap_or(f64::NAN));
            (0..seeds.len()).map(of_seed).collect()
        };
        // Of one run, so that its stages add up.
        let seconds = |value: &dyn Fn(&Seconds) -> f64| over_scenes(&|runs| value(median_run(runs)));
        let (psnrs, ssims) = (per_seed(|run| run.psnr_held_out), per_seed(|run| run.ssim_held_out));
        let lpips = mean(per_seed(|run| run.lpips_held_out).into_iter());
        let spread = deviation(&psnrs)
            .zip(deviation(&ssims))
            .map(|(psnr_held_out, ssim_held_out)| Spread { psnr_held_out, ssim_held_out });
        let per_frame = |run: &&Measured| run.seconds_per_frame.unwrap_or(f64::NAN);
        Row {
            label: label.clone(),
            gaussians: mean(per_seed(|run| Some(run.gaussians as f64)).into_iter()),
            psnr_held_out: mean(psnrs.into_iter()),
            ssim_held_out: mean(ssims.into_iter()),
            lpips_held_out: Some(lpips).filter(|lpips| lpips.is_finite()),
            spread,
            seconds: Seconds::of_each(|value| seconds(value)),
            seconds_to_gaussians: seconds(&Seconds::to_gaussians),
            frames_per_second: 1.0 / over_scenes(&|runs| median(runs.iter().map(per_frame))),
            ply_bytes: mean(per_seed(|run| Some(run.ply_bytes as f64)).into_iter()),
            peak_rss_bytes: runs.iter().flatten().filter_map(|run| run.peak_rss_bytes).max(),
            on_front_of_seconds: false,
            on_front_of_gaussians: false,
            pareto: false,
            failed,
        }
    }

    /// Why a point has no figures.
    fn why_not(&self, point: &str) -> String {
        let of_point = |failed: &&&Failed| failed.point.as_deref().is_none_or(|name| name == point);
        let ours = |failed: &&&Failed| self.windows.contains(&failed.window.as_str());
        match self.failed.iter().filter(ours).find(of_point) {
            Some(failed) => format!("{}: {}", failed.window, failed.reason),
            None => "not measured on every window".to_owned(),
        }
    }
}

#[cfg(test)]
#[path = "summary_tests.rs"]
pub(super) mod tests;
