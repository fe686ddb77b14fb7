//! Findings about the files: pictures, depth, lenses.

use super::readings::{median, quantile};
use super::report::{DepthFileSummary, Finding, LensSummary, PictureSummary, Severity, SizeCount};
use super::scan::Scan;
use super::{finding, listed};
use glam::DVec2;
use gs_scene::Intrinsics;
use std::collections::BTreeMap;
use view_data::{Dataset, Error, Frame, JpegRule, Lens, Result};

/// Sharpness under this share of the median is called blurred.
const BLURRED: f64 = 0.15;
/// Ratio of the mean brightness of frames that follow each other, from which on it is a jump.
const JUMP: f64 = 1.5;
/// Share of the side by which a principal point may be off the centre.
const OFF_CENTRE: f64 = 0.1;
/// fy over fx of pictures that were not stretched.
const STRETCHED: f64 = 1.05;
/// Fields of view of usual lenses, degrees.
const USUAL_FIELD: [f64; 2] = [15.0, 120.0];
/// Measured share of a depth map under which it is called sparse.
const SPARSE: f64 = 0.2;
/// Pictures whose pixels are all alike have next to no contrast: variance of the Laplacian, grey levels
/// squared.
const FLAT: f64 = 0.05;

/// Errors with their causes, in one line.
pub(crate) fn chain(error: &Error) -> String {
    let causes = std::iter::successors(Some(error as &dyn std::error::Error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// The pictures: what there is, what is missing or broken, and what looks odd.
pub(crate) fn judge_pictures(
    dataset: &Dataset,
    scans: &[Result<Scan>],
    findings: &mut Vec<Finding>,
) -> PictureSummary {
    let mut summary = PictureSummary::default();
    let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (frame, scan) in dataset.frames.iter().zip(scans) {
        match scan {
            Ok(scan) => {
                summary.decoded += 1;
                let Intrinsics { width, height, .. } = scan.lens.intrinsics;
                *sizes.entry((width, height)).or_default() += 1;
            }
            Err(error) => {
                let rule = if matches!(error, Error::MissingPicture { .. }) {
                    summary.missing += 1;
                    "picture-missing"
                } else {
                    summary.broken += 1;
                    broken_rule(error)
                };
                let place = format!("{} ({})", frame.image, frame.name);
                findings.push(finding(Severity::Error, place, rule, chain(error)));
            }
        }
    }
    summary.sizes =
        sizes.into_iter().map(|((width, height), frames)| SizeCount { width, height, frames }).collect();
    summary.sizes.sort_by_key(|size| (std::cmp::Reverse(size.frames), size.width, size.height));
    if summary.sizes.len() > 1 {
        let sizes = summary.sizes.iter().map(|s| format!("{} of {}x{}", s.frames, s.width, s.height));
        let text = format!(
            "pictures have {} sizes: {}; ask for one size, to which all are scaled and cropped",
            summary.sizes.len(),
            listed(sizes)
        );
        findings.push(finding(Severity::Warning, "pictures", "sizes-mixed", text));
    }
    if summary.decoded == scans.len() {
        let text = format!("all {} pictures are there and decode to their end", summary.decoded);
        findings.push(finding(Severity::Ok, "pictures", "pictures-decode", text));
    }
    let read: Vec<(&Frame, &Scan)> = dataset
        .frames
        .iter()
        .zip(scans)
        .filter_map(|(frame, scan)| Some((frame, scan.as_ref().ok()?)))
        .collect();
    summary.brightness = extent(read.iter().map(|(_, scan)| scan.brightness));
    summary.sharpness = extent(read.iter().map(|(_, scan)| scan.sharpness));
    judge_duplicates(&read, findings);
    judge_look(&read, &summary, findings);
    summary
}

fn broken_rule(error: &Error) -> &'static str {
    match error {
        Error::DamagedJpeg { source: JpegRule::NoEnd, .. } => "picture-truncated",
        Error::DamagedJpeg { .. } => "picture-damaged",
        Error::Aspect { .. } => "picture-aspect",
        Error::TooLarge { .. } => "picture-too-large",
        _ => "picture-broken",
    }
}

/// Least, median, greatest.
fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 3]> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    Some([*values.first()?, quantile(&values, 0.5)?, *values.last()?])
}

fn judge_duplicates(read: &[(&Frame, &Scan)], findings: &mut Vec<Finding>) {
    let mut same: BTreeMap<(usize, u64), Vec<&Frame>> = BTreeMap::new();
    for (frame, scan) in read {
        same.entry(scan.digest).or_default().push(frame);
    }
    for frames in same.values().filter(|frames| frames.len() > 1) {
        let text = format!(
            "the pictures of {} have the same bytes; at most one of these frames can have the right pose: \
             remove the others",
            listed(frames.iter().map(|frame| frame.name.clone()))
        );
        let place = format!("{} ({})", frames[0].image, frames[0].name);
        findings.push(finding(Severity::Error, place, "picture-duplicate", text));
    }
}

fn judge_look(read: &[(&Frame, &Scan)], summary: &PictureSummary, findings: &mut Vec<Finding>) {
    let flat: Vec<&str> =
        read.iter().filter(|(_, scan)| scan.sharpness < FLAT).map(|(frame, _)| frame.name.as_str()).collect();
    if !flat.is_empty() {
        let text = format!(
            "{} of {} pictures show nothing (no detail at all): {}; remove these frames",
            flat.len(),
            read.len(),
            listed(flat.iter())
        );
        findings.push(finding(Severity::Warning, "pictures", "picture-empty", text));
    }
    if let Some([_, middle, _]) = summary.sharpness {
        let blurred =
            read.iter().filter(|(_, scan)| scan.sharpness >= FLAT && scan.sharpness < BLURRED * middle);
        let blurred: Vec<&str> = blurred.map(|(frame, _)| frame.name.as_str()).collect();
        if !blurred.is_empty() {
            let text = format!(
                "{} of {} pictures are far less sharp than the median (blurred, out of focus, or of \
                 something \
                 plain): {}; look at them, and leave out what is blurred",
                blurred.len(),
                read.len(),
                listed(blurred.iter())
            );
            findings.push(finding(Severity::Note, "pictures", "picture-blurred", text));
        }
    }
    let jumps = read.windows(2).filter_map(|pair| {
        let (a, b) = (pair[0].1.brightness, pair[1].1.brightness);
        let ratio = if a > b { a / b } else { b / a };
        (ratio > JUMP).then(|| (ratio, format!("{} to {}", pair[0].0.name, pair[1].0.name)))
    });
    let jumps: Vec<(f64, String)> = jumps.collect();
    if !jumps.is_empty() {
        let worst = jumps.iter().map(|(ratio, _)| *ratio).fold(1.0, f64::max);
        let text = format!(
            "the mean brightness changes by more than {JUMP} between {} pairs of frames that follow each \
             other, {worst:.1} \
             times at most: {}; the view or the exposure jumps there, and fixed exposure gives better \
             colours",
            jumps.len(),
            listed(jumps.iter().map(|(_, names)| names))
        );
        findings.push(finding(Severity::Note, "pictures", "brightness-jump", text));
    }
}

/// Coordinates too large for what scenes are stored in.
pub(crate) fn judge_offset(dataset: &Dataset, findings: &mut Vec<Finding>) {
    if let Some(offset) = dataset.offset {
        let text = format!(
            "positions are far from the origin: ({}, {}, {}) is subtracted from all when they are read, as scenes are stored as 32-bit \
             numbers",
            offset.x, offset.y, offset.z
        );
        findings.push(finding(Severity::Note, dataset.file.display().to_string(), "far-from-origin", text));
    }
}

/// What the reader could not use; missing pictures are named with the pictures.
pub(crate) fn judge_ledger(dataset: &Dataset, findings: &mut Vec<Finding>) {
    let missing = |key: &str| dataset.frames.iter().any(|f| f.name == key && f.image.is_missing());
    let dropped: Vec<_> = dataset.dropped.iter().filter(|dropped| !missing(&dropped.key)).collect();
    for dropped in dropped.iter().take(MAX_DROPPED) {
        findings.push(finding(Severity::Warning, dropped.key.clone(), "not-used", dropped.reason.clone()));
    }
    if dropped.len() > MAX_DROPPED {
        let text = format!("{} more entries of the data set are not used", dropped.len() - MAX_DROPPED);
        findings.push(finding(Severity::Warning, dataset.file.display().to_string(), "not-used", text));
    }
}

/// Unused entries that are named one by one, at most.
const MAX_DROPPED: usize = 100;

/// The files of measured depth.
pub(crate) fn judge_depth_files(
    dataset: &Dataset,
    scans: &[Result<Scan>],
    findings: &mut Vec<Finding>,
) -> Option<DepthFileSummary> {
    let with: Vec<(&Frame, f64)> =
        dataset.frames.iter().filter_map(|frame| Some((frame, frame.depth.as_ref()?.unit))).collect();
    if with.is_empty() {
        return None;
    }
    let units = extent(with.iter().map(|(_, unit)| *unit))?;
    let mut coverage = Vec::new();
    let (mut empty, mut sparse) = (Vec::new(), Vec::new());
    for (frame, scan) in dataset.frames.iter().zip(scans) {
        let Some(depth) = scan.as_ref().ok().and_then(|scan| scan.depth.as_ref()) else { continue };
        match depth {
            Ok(depth) => {
                coverage.push(depth.coverage);
                if depth.coverage == 0.0 {
                    empty.push(frame.name.as_str());
                } else if depth.coverage < SPARSE {
                    sparse.push(frame.name.as_str());
                }
            }
            Err(error) => {
                let file =
                    frame.depth.as_ref().map_or_else(String::new, |file| file.path.display().to_string());
                let rule = match error {
                    Error::MissingPicture { .. } => "depth-missing",
                    Error::Aspect { .. } => "depth-aspect",
                    Error::DepthFormat { .. } => "depth-format",
                    _ => "depth-broken",
                };
                findings.push(finding(
                    Severity::Error,
                    format!("{file} ({})", frame.name),
                    rule,
                    chain(error),
                ));
            }
        }
    }
    let decoded = coverage.len();
    if !empty.is_empty() {
        let text = format!(
            "{} of {decoded} depth files hold no measurement at all (all 0, or not finite): {}; export them \
             again, or drop the \
             depth of these frames",
            empty.len(),
            listed(empty.iter())
        );
        findings.push(finding(Severity::Error, "depth", "depth-empty", text));
    }
    if !sparse.is_empty() {
        let text = format!(
            "{} of {decoded} depth files cover less than {:.0} % of their picture: {}",
            sparse.len(),
            100.0 * SPARSE,
            listed(sparse.iter())
        );
        findings.push(finding(Severity::Note, "depth", "depth-sparse", text));
    }
    if with.len() < dataset.frames.len() {
        let text = format!("{} of {} frames have a depth file", with.len(), dataset.frames.len());
        findings.push(finding(Severity::Note, "depth", "depth-partial", text));
    }
    let coverage = median(coverage).unwrap_or(0.0);
    Some(DepthFileSummary { frames: with.len(), decoded, unit: [units[0], units[2]], coverage })
}

/// The lenses as they are stated.
pub(crate) fn judge_lenses(dataset: &Dataset, findings: &mut Vec<Finding>) -> LensSummary {
    let mut summary = LensSummary {
        field_of_view: [f64::INFINITY, 0.0],
        focal_over_width: [f64::INFINITY, 0.0],
        focal_ratio: 1.0,
        ..LensSummary::default()
    };
    let mut different: Vec<Lens> = Vec::new();
    for frame in &dataset.frames {
        let Intrinsics { fx, fy, cx, cy, width, height } = frame.lens.intrinsics;
        let (width, height) = (width as f64, height as f64);
        let field = 2.0 * (0.5 * width / fx).atan().to_degrees();
        let widen = |range: &mut [f64; 2], value: f64| *range = [range[0].min(value), range[1].max(value)];
        widen(&mut summary.field_of_view, field);
        widen(&mut summary.focal_over_width, fx / width);
        summary.focal_ratio = summary.focal_ratio.max((fx / fy).max(fy / fx));
        let off = (cx / width - 0.5).abs().max((cy / height - 0.5).abs());
        summary.off_centre = summary.off_centre.max(off);
        // Most sets have one lens: what is measured of it once holds for all.
        if different.last() != Some(&frame.lens) && !different.contains(&frame.lens) {
            if different.len() < MAX_LENSES {
                summary.distortion_pixels = summary.distortion_pixels.max(distortion(&frame.lens));
            }
            different.push(frame.lens);
        }
        summary.distorted += usize::from(!frame.lens.model.is_pinhole());
    }
    summary.different = different.len();
    if dataset.frames.is_empty() {
        return LensSummary::default();
    }
    let [narrow, wide] = summary.field_of_view;
    if narrow < USUAL_FIELD[0] || wide > USUAL_FIELD[1] {
        let text = format!(
            "the focal length gives a horizontal field of view of {narrow:.1} to {wide:.1} degrees, which \
             few lenses have; are \
             the intrinsics in pixels, and for this size of picture?"
        );
        findings.push(finding(Severity::Warning, "intrinsics", "field-of-view", text));
    }
    if summary.focal_ratio > STRETCHED {
        let text = format!(
            "fx and fy differ by {:.1} %: pixels that are not square are rare; were the pictures stretched?",
            100.0 * (summary.focal_ratio - 1.0)
        );
        findings.push(finding(Severity::Note, "intrinsics", "focal-ratio", text));
    }
    if summary.off_centre > OFF_CENTRE {
        let text = format!(
            "the principal point is up to {:.0} % of the side off the centre; that is right for cropped \
             pictures, else the \
             intrinsics are for another size",
            100.0 * summary.off_centre
        );
        findings.push(finding(Severity::Warning, "intrinsics", "principal-point", text));
    }
    if summary.distorted > 0 {
        let text = format!(
            "{} of {} frames have lens distortion, which moves pixels by up to {:.1}; it is taken out when \
             pictures are loaded",
            summary.distorted,
            dataset.frames.len(),
            summary.distortion_pixels
        );
        findings.push(finding(Severity::Note, "intrinsics", "distortion", text));
    }
    summary
}

/// Lenses whose distortion is measured, at most.
const MAX_LENSES: usize = 64;

/// How far the distortion moves what the corners and the middles of the edges show, pixels.
fn distortion(lens: &Lens) -> f64 {
    let Intrinsics { fx, fy, cx, cy, width, height } = lens.intrinsics;
    let (width, height) = (width as f64, height as f64);
    let on_border =
        [0.0, 0.5, 1.0].into_iter().flat_map(|x| [0.0, 0.5, 1.0].map(|y| DVec2::new(x * width, y * height)));
    let moved = on_border.filter_map(|pixel| {
        let direction = lens.undistort(pixel)?;
        Some(pixel.distance(DVec2::new(fx * direction.x + cx, fy * direction.y + cy)))
    });
    moved.fold(0.0, f64::max)
}
