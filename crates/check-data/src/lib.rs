#![doc = include_str!("../README.md")]

mod depth;
mod epipolar;
mod features;
mod fundamental;
mod grey;
mod html;
mod layout;
mod linear;
mod matching;
mod pairs;
mod range;
mod readings;
mod report;
mod scan;
mod verdict_files;
mod verdict_frames;
mod verdict_poses;
mod verdict_space;

use epipolar::Posed;
use glam::DVec2;
use gs_scene::{Camera, Intrinsics};
use matching::match_pictures;
use range::{Known, find_range, points_of_matches};
use rayon::prelude::*;
use readings::PairMatches;
use scan::{Counter, Scan, Wanted, read_sizes, scan_frames};
use std::fmt::Display;
use view_data::{Dataset, Result, ScenePoint, estimate_scene_depth};

pub use html::layout_html;
pub use report::{
    CameraSummary, CheckReport, DepthFileSummary, DepthSummary, Finding, LayoutSummary, LensSummary,
    OverlapSummary, PictureSummary, PoseSummary, RangeSource, RangeSummary, Reading, ReadingScore, Severity,
    SizeCount, Thumbnail,
};

/// How much is looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CheckSettings {
    /// Pairs of pictures that are matched at most; spread over the frames. Time and memory grow with them.
    pub pairs: usize,
    /// Corners that are described in each matched picture, about.
    pub corners: usize,
    /// Small pictures that the page shows, spread over the frames.
    pub thumbnails: usize,
    /// Seed of the random draws of matching.
    pub seed: u64,
}

impl Default for CheckSettings {
    fn default() -> Self {
        Self { pairs: 120, corners: 900, thumbnails: 12, seed: 0 }
    }
}

/// A part of a check that takes time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum CheckStage {
    /// Reading the headers of all pictures.
    Headers,
    /// Decoding all pictures and depth files.
    Pictures,
    /// Matching pairs of pictures.
    Pairs,
}

/// How far a check is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CheckStep {
    /// What is being done.
    pub stage: CheckStage,
    /// Files or pairs that are done.
    pub done: usize,
    /// Files or pairs in all.
    pub of: usize,
}

/// Looks at everything that a data set may have wrong: every picture and depth file is decoded; matches
/// between pictures, found without the poses, are held against the poses as read and as the usual misreadings
/// would have them; depth is held against both; the layout of the cameras, the range of depths and the
/// overlap of the views are measured.
///
/// `on_step` is called from several threads, not always in order. Pictures are decoded a few at a time:
/// memory grows with [`CheckSettings::pairs`], hardly with the number of frames. The same data and settings
/// give the same report on any number of threads.
///
/// What is wrong with the data is a [`Finding`], not an error.
///
/// # Errors
/// If the numbers of a frame make no camera, which no reader lets through.
pub fn check_data(
    dataset: &Dataset,
    settings: &CheckSettings,
    on_step: impl Fn(CheckStep) + Sync,
) -> Result<CheckReport> {
    let cameras = dataset.cameras()?;
    let mut findings = Vec::new();
    let count = dataset.frames.len();
    let sizes = read_sizes(dataset, &on_step);
    // Pairs are chosen before anything is decoded, by the cameras as they are stated.
    let stated: Vec<Option<Posed>> =
        (0..count).map(|i| sizes[i].is_ok().then(|| posed(dataset, i, cameras[i].intrinsics()))).collect();
    let typical = dataset.depth_percentiles.map(|p| p.p50).filter(|depth| *depth > 0.0);
    let typical = typical.or_else(|| estimate_scene_depth(&cameras).map(|depth| depth.median));
    let chosen = pairs::choose_pairs(&stated, typical, settings.pairs);
    let wanted = Wanted {
        matched: chosen.iter().flat_map(|&(i, j)| [i, j]).collect(),
        shown: evenly(count, settings.thumbnails).collect(),
    };
    let mut scans = scan_frames(dataset, &sizes, &wanted, settings, &on_step);

    let pictures = verdict_files::judge_pictures(dataset, &scans, &mut findings);
    let lens = verdict_files::judge_lenses(dataset, &mut findings);
    let depth_files = verdict_files::judge_depth_files(dataset, &scans, &mut findings);
    verdict_files::judge_ledger(dataset, &mut findings);
    verdict_files::judge_offset(dataset, &mut findings);

    let thumbnails = scans.iter_mut().flatten().filter_map(|scan| scan.thumbnail.take()).collect();
    let scans: Vec<Option<&Scan>> = scans.iter().map(|scan| scan.as_ref().ok()).collect();
    // From here on the cameras are those of the pictures that are matched.
    let matched: Vec<Option<Posed>> = (0..count)
        .map(|i| scans[i].map(|scan| posed(dataset, i, &reduced(&scan.lens.intrinsics, scan.step))))
        .collect();
    let found = match_all(&chosen, &scans, settings.seed, &on_step);
    let evidence = verdict_poses::Evidence {
        dataset,
        posed: &matched,
        tried: chosen.len(),
        pairs: &found,
        reduction: scans.iter().flatten().map(|scan| scan.step).max().unwrap_or(1),
    };
    let judged = verdict_poses::judge_poses(&evidence, &mut findings);
    let depth = depth::check_depth(&scans, &matched, &found);
    verdict_space::judge_depth(depth.as_ref(), depth_files.as_ref(), judged.fit, &mut findings);

    let points = read_points(dataset, &mut findings);
    let known = Known {
        dataset,
        cameras: &cameras,
        points: &points,
        scans: &scans,
        posed: &matched,
        pairs: &found,
        poses_fit: judged.fit,
        depth_fits: verdict_space::depth_has_its_scale(depth.as_ref()),
    };
    let range = find_range(&known);
    verdict_space::judge_range(range.as_ref(), judged.fit, &mut findings);
    let layout = verdict_space::judge_layout(dataset, typical, &mut findings);
    let overlap = verdict_space::judge_overlap(dataset, &cameras, range.as_ref(), &mut findings);

    let camera = |i: usize| camera_summary(dataset, &cameras[i], i, scans[i], &judged, overlap.as_ref());
    // Stable: equal severities keep the order in which things were looked at.
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    Ok(CheckReport {
        name: dataset.name.clone(),
        file: dataset.file.display().to_string(),
        format: dataset.format.to_string(),
        frames: count,
        pictures,
        lens,
        depth_files,
        masks: dataset.frames.iter().filter(|frame| frame.mask_path.is_some()).count(),
        depth,
        range,
        layout,
        cameras: (0..count).map(camera).collect(),
        points: sample_points(&points, &matched, &found, judged.fit),
        overlap: overlap.map(|overlap| overlap.summary),
        poses: judged.summary,
        findings,
        thumbnails,
    })
}

/// Points that a report keeps, at most.
const MAX_POINTS: usize = 3000;

fn finding(
    severity: Severity,
    place: impl Into<String>,
    rule: &'static str,
    text: impl Into<String>,
) -> Finding {
    Finding { severity, place: place.into(), rule, text: text.into() }
}

/// The first of a list of names, and how many more there are.
fn listed(names: impl IntoIterator<Item = impl Display>) -> String {
    const SHOWN: usize = 8;
    let names: Vec<String> = names.into_iter().map(|name| name.to_string()).collect();
    let shown = names[..names.len().min(SHOWN)].join(", ");
    if names.len() > SHOWN { format!("{shown} and {} more", names.len() - SHOWN) } else { shown }
}

/// Positions 0..count, at most `wanted` of them, evenly.
fn evenly(count: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let taken = wanted.min(count);
    (0..taken).map(move |k| k * count / taken)
}

fn posed(dataset: &Dataset, i: usize, intrinsics: &Intrinsics) -> Posed {
    let frame = &dataset.frames[i];
    Posed { intrinsics: *intrinsics, axes: frame.axes, position: frame.position }
}

/// Intrinsics of a picture of which every `step` pixels are one.
fn reduced(intrinsics: &Intrinsics, step: usize) -> Intrinsics {
    let by = step as f64;
    let Intrinsics { fx, fy, cx, cy, width, height } = *intrinsics;
    let side = |side: usize| (side / step).max(1);
    Intrinsics {
        fx: fx / by,
        fy: fy / by,
        cx: cx / by,
        cy: cy / by,
        width: side(width),
        height: side(height),
    }
}

fn match_all(
    chosen: &[(usize, usize)],
    scans: &[Option<&Scan>],
    seed: u64,
    on_step: &(impl Fn(CheckStep) + Sync),
) -> Vec<PairMatches> {
    let done = Counter::new(CheckStage::Pairs, chosen.len(), on_step);
    let match_pair = |&(first, second): &(usize, usize)| {
        let pair = [scans[first], scans[second]];
        let [Some(a), Some(b)] = pair else { return None };
        let (Some(features_a), Some(features_b)) = (a.features.as_ref(), b.features.as_ref()) else {
            return None;
        };
        let straighten = |which: usize, pixel: DVec2| {
            let Scan { lens, step, .. } = pair[which]?;
            if lens.model.is_pinhole() {
                return Some(pixel);
            }
            let direction = lens.undistort(pixel * *step as f64)?;
            let Intrinsics { fx, fy, cx, cy, .. } = lens.intrinsics;
            // Far out of the axis a pinhole stretches what is a pixel beyond use.
            let usable = direction.length() < MAX_TANGENT;
            usable.then(|| (direction * DVec2::new(fx, fy) + DVec2::new(cx, cy)) / *step as f64)
        };
        let seed = seed ^ ((first as u64) << 32 | second as u64);
        let matches = match_pictures(features_a, features_b, seed, straighten);
        done.advance();
        (!matches.is_empty()).then_some(PairMatches { first, second, matches })
    };
    let found: Vec<Option<PairMatches>> = chosen.par_iter().map(match_pair).collect();
    found.into_iter().flatten().collect()
}

/// Tangent of the angle from the axis up to which matches are taken.
const MAX_TANGENT: f64 = 2.0;

fn read_points(dataset: &Dataset, findings: &mut Vec<Finding>) -> Vec<ScenePoint> {
    match dataset.points() {
        Ok(points) => points.unwrap_or_default(),
        Err(error) => {
            let text = verdict_files::chain(&error);
            findings.push(finding(Severity::Error, "points", "points-broken", text));
            Vec::new()
        }
    }
}

/// The data set's points, or, where it has none and the poses fit, triangulated matches.
fn sample_points(
    points: &[ScenePoint],
    posed: &[Option<Posed>],
    pairs: &[PairMatches],
    poses_fit: bool,
) -> Vec<[f64; 3]> {
    let all: Vec<[f64; 3]> = if points.is_empty() && poses_fit {
        points_of_matches(posed, pairs).into_iter().map(|point| point.world.to_array()).collect()
    } else {
        points.iter().map(|point| point.position.to_array()).collect()
    };
    evenly(all.len(), MAX_POINTS).map(|k| all[k]).collect()
}

fn camera_summary(
    dataset: &Dataset,
    camera: &Camera,
    i: usize,
    scan: Option<&Scan>,
    judged: &verdict_poses::Judged,
    overlap: Option<&layout::Overlap>,
) -> CameraSummary {
    let frame = &dataset.frames[i];
    let Intrinsics { fx, fy, width, height, .. } = *camera.intrinsics();
    CameraSummary {
        name: frame.name.clone(),
        position: frame.position.to_array(),
        axes: frame.axes.to_cols_array_2d(),
        half_field: [0.5 * width as f64 / fx, 0.5 * height as f64 / fy],
        brightness: scan.map(|scan| scan.brightness),
        sharpness: scan.map(|scan| scan.sharpness),
        epipolar: judged.medians[i].filter(|value| value.is_finite()),
        matches: judged.matches[i],
        shared: overlap.map(|overlap| overlap.shared[i]),
        component: overlap.map(|overlap| overlap.component[i]),
    }
}
