//! Findings about space: depth, range, the places of the cameras, and their overlap.

use super::layout::{MAX_OVERLAP_FRAMES, Overlap, find_layout, find_overlap, off_line};
use super::report::{
    DepthFileSummary, DepthSummary, Finding, LayoutSummary, RangeSource, RangeSummary, Severity,
};
use super::{finding, listed};
use glam::DVec3;
use gs_scene::Camera;
use view_data::{Dataset, SceneDepth};

/// Share of warped pixels that agree, of depth that is good.
const CONSISTENT: f64 = 0.8;
/// Deviation of the depth's scale from the poses' that is let pass.
const SCALE: f64 = 0.03;
/// Beyond this it is not a matter of accuracy.
const WRONG_SCALE: f64 = 0.2;
/// Depth along the ray explains the matches if the deviation is so much smaller.
const RAY_GAIN: f64 = 0.6;
/// Coordinates beyond this are suspect, scene units.
const FAR_AWAY: f64 = 1e3;
/// Poses nearer than this, in typical depths, and with less turn than this, radians, are the same.
const SAME_POSE: (f64, f64) = (1e-4, 1e-3);
/// Cameras that deviate less from a line than this share of their extent are on it.
const ON_LINE: f64 = 0.02;
/// Units of depth files that occur, counts per metre.
const USUAL_COUNTS: [f64; 6] = [1.0, 256.0, 1000.0, 4000.0, 5000.0, 6553.5];

/// Whether measured depth is in the units of the poses: with another unit it says nothing of the range. What
/// is not known is believed.
pub(crate) fn depth_has_its_scale(depth: Option<&DepthSummary>) -> bool {
    depth.and_then(|depth| depth.ratio).is_none_or(|ratio| (ratio - 1.0).abs() <= WRONG_SCALE)
}

pub(crate) fn judge_depth(
    depth: Option<&DepthSummary>,
    files: Option<&DepthFileSummary>,
    poses_fit: bool,
    findings: &mut Vec<Finding>,
) {
    let Some(files) = files.filter(|files| files.decoded > 0) else { return };
    let Some(depth) = depth.filter(|_| poses_fit) else {
        let text = "measured depth was not held against the poses: no pair of frames with depth has matches \
         under poses that fit";
        findings.push(finding(Severity::Note, "depth", "depth-unchecked", text));
        return;
    };
    let mut right = true;
    if let Some(ratio) = depth.ratio {
        let spread = depth.spread_z.unwrap_or(0.0);
        if (ratio - 1.0).abs() > SCALE + spread / (depth.matches as f64).sqrt() {
            right = false;
            let severity =
                if (ratio - 1.0).abs() > WRONG_SCALE { Severity::Error } else { Severity::Warning };
            let unit = files.unit[0] / ratio;
            // Files whose unit is theirs to state are told the right one.
            let near = |counts: &&f64| (unit * **counts - 1.0).abs() < 0.1;
            let usual = USUAL_COUNTS.iter().find(near);
            let hint = usual.map_or_else(String::new, |counts| format!(" (1/{counts}, a usual one)"));
            let text = format!(
                "measured depth is {ratio:.3} times what the poses say ({} matches, {:.1} % spread): the \
                 depth unit is {:.6} but \
                 reads as {unit:.6}{hint}, or the poses have another scale; set the unit to {unit:.6}, or \
                 scale the poses by {ratio:.4}",
                depth.matches,
                100.0 * spread,
                files.unit[0]
            );
            findings.push(finding(severity, "depth", "depth-scale", text));
        }
        if let (Some(z), Some(ray)) = (depth.spread_z, depth.spread_ray)
            && ray < RAY_GAIN * z
            && z > 0.01
        {
            right = false;
            let text = format!(
                "depth reads as the distance along the ray, not along the camera's axis: against matches it \
                 spreads by \
                 {:.1} % instead of {:.1} %; divide it by the length of the ray of unit z",
                100.0 * ray,
                100.0 * z
            );
            findings.push(finding(Severity::Error, "depth", "depth-along-ray", text));
        }
    } else {
        let text = format!(
            "the scale of measured depth was not checked: {} matches have depth and enough angle, too few",
            depth.matches
        );
        findings.push(finding(Severity::Note, "depth", "depth-scale-unchecked", text));
    }
    let Some(consistent) = depth.consistent else { return };
    let figures = format!(
        "{:.1} % of the pixels of {} pairs agree within 2 % when depth is warped from view to view, median \
         difference {}",
        100.0 * consistent,
        depth.pairs,
        depth.median_difference.map_or_else(|| "-".to_owned(), |d| format!("{:.2} %", 100.0 * d))
    );
    if consistent < CONSISTENT && right {
        let text = format!(
            "measured depth does not agree from view to view: {figures}; is it registered to the pictures?"
        );
        findings.push(finding(Severity::Warning, "depth", "depth-consistency", text));
    } else if right {
        let ratio =
            depth.ratio.map_or_else(String::new, |r| format!("; measured over triangulated depth {r:.4}"));
        findings.push(finding(
            Severity::Ok,
            "depth",
            "depth-consistency",
            format!("depth fits the poses: {figures}{ratio}"),
        ));
    }
}

pub(crate) fn judge_range(range: Option<&RangeSummary>, poses_fit: bool, findings: &mut Vec<Finding>) {
    let Some(RangeSummary { source, percentiles: [_, p2, p50, p98, _], near_far: [near, far] }) =
        range.copied()
    else {
        let text = "nothing tells how far away the scene is: no depth, no points, no matches, and cameras in \
         one place";
        findings.push(finding(Severity::Warning, "range", "range-unknown", text));
        return;
    };
    let from = match source {
        RangeSource::Measured => "measured depth",
        RangeSource::Points => "the data set's points",
        RangeSource::Stated => "the file's statement",
        RangeSource::Matches => "triangulated matches",
        RangeSource::Poses => "the poses alone, a guess",
    };
    let severity = if source == RangeSource::Poses { Severity::Warning } else { Severity::Ok };
    let text = format!(
        "98 % of the scene lies between {p2:.3} and {p98:.3} scene units, half of it nearer than {p50:.3} \
         (from {from}); \
         the depth range {near},{far} holds it"
    );
    findings.push(finding(severity, "range", "range", text));
    if !poses_fit && matches!(source, RangeSource::Points) {
        let text = "the range comes from points under poses that were not found to fit the pictures";
        findings.push(finding(Severity::Note, "range", "range-unsure", text));
    }
}

pub(crate) fn judge_layout(
    dataset: &Dataset,
    depth: Option<f64>,
    findings: &mut Vec<Finding>,
) -> LayoutSummary {
    let positions: Vec<DVec3> = dataset.frames.iter().map(|frame| frame.position).collect();
    let names: Vec<&str> = dataset.frames.iter().map(|frame| frame.name.as_str()).collect();
    let layout = find_layout(&positions, &names);
    if !layout.outliers.is_empty() {
        let text = format!(
            "{} cameras are more than 10 times as far from the middle as half of them are: {}; failed poses? \
             remove these frames",
            layout.outliers.len(),
            listed(layout.outliers.iter())
        );
        findings.push(finding(Severity::Warning, "cameras", "camera-outlier", text));
    }
    let far: Vec<&str> = (0..positions.len())
        .filter(|&i| positions[i].abs().max_element() > FAR_AWAY)
        .map(|i| names[i])
        .collect();
    if !far.is_empty() {
        let text = format!(
            "{} cameras have coordinates beyond {FAR_AWAY}: {}; single precision loses digits there: move \
             the origin into the \
             scene, and check the unit (millimetres?)",
            far.len(),
            listed(far.iter())
        );
        findings.push(finding(Severity::Warning, "cameras", "camera-far", text));
    }
    if positions.len() == 1 {
        let text = "there is one frame only: nothing can be matched or triangulated, and stereo needs two";
        findings.push(finding(Severity::Warning, "cameras", "one-frame", text));
        return layout;
    }
    let scale = positions.iter().map(|p| p.length()).fold(0.0, f64::max);
    let one_place = layout.reach <= 1e-9 * scale;
    if one_place {
        let text = "all cameras are in one place: pictures that only turn show no depth, and stereo cannot \
         work; are the \
                    translations missing?";
        findings.push(finding(Severity::Error, "cameras", "one-place", text));
    } else if positions.len() > 2 && off_line(&positions).is_some_and(|off| off < ON_LINE) {
        let text = "all cameras are on one line: some misreadings of the poses cannot be told from right \
         ones there, and depth \
                    along the line is poor";
        findings.push(finding(Severity::Note, "cameras", "one-line", text));
    }
    if !one_place {
        judge_twins(dataset, depth.unwrap_or(layout.spread), findings);
    }
    layout
}

/// Frames whose poses are the same.
fn judge_twins(dataset: &Dataset, depth: f64, findings: &mut Vec<Finding>) {
    let (apart, turn) = (SAME_POSE.0 * depth, SAME_POSE.1);
    // Sorted along an axis, those that are the same are neighbours but for a few.
    let mut order: Vec<usize> = (0..dataset.frames.len()).collect();
    let x = |i: usize| dataset.frames[i].position.x;
    order.sort_by(|&a, &b| x(a).total_cmp(&x(b)).then(a.cmp(&b)));
    let mut twins = Vec::new();
    let mut looked = 0usize;
    for (k, &a) in order.iter().enumerate() {
        for &b in order[k + 1..].iter().take_while(|&&b| x(b) - x(a) <= apart) {
            looked += 1;
            let (one, other) = (&dataset.frames[a], &dataset.frames[b]);
            // |R - R'| of the axes is about the angle between them.
            let angle = (0..3).map(|c| one.axes.col(c).distance(other.axes.col(c))).fold(0.0, f64::max);
            if one.position.distance(other.position) <= apart && angle <= turn {
                twins.push((a.min(b), a.max(b)));
            }
        }
        if looked > MAX_LOOKS {
            let text = "looking for equal poses was cut short: too many cameras share one coordinate";
            findings.push(finding(Severity::Note, "cameras", "pose-twins-unchecked", text));
            break;
        }
    }
    if twins.is_empty() {
        return;
    }
    twins.sort_unstable();
    let name = |i: usize| dataset.frames[i].name.as_str();
    let text = format!(
        "{} pairs of frames have the same pose: {}; one of each pair adds nothing, or has a wrong pose",
        twins.len(),
        listed(twins.iter().map(|&(a, b)| format!("{} = {}", name(a), name(b))))
    );
    findings.push(finding(Severity::Note, "cameras", "pose-twins", text));
}

/// Comparisons of poses, at most.
const MAX_LOOKS: usize = 20_000_000;

pub(crate) fn judge_overlap(
    dataset: &Dataset,
    cameras: &[Camera],
    range: Option<&RangeSummary>,
    findings: &mut Vec<Finding>,
) -> Option<Overlap> {
    let [_, near, median, far, _] = range?.percentiles;
    let depth = SceneDepth { near, median, far };
    if cameras.len() < 2 || depth.check().is_err() {
        return None;
    }
    if cameras.len() > MAX_OVERLAP_FRAMES {
        let text = format!(
            "the overlap of {} frames was not measured: it is looked for among {MAX_OVERLAP_FRAMES} at most",
            cameras.len()
        );
        findings.push(finding(Severity::Note, "overlap", "overlap-unchecked", text));
        return None;
    }
    let overlap = find_overlap(cameras, depth);
    let name = |i: usize| dataset.frames[i].name.as_str();
    let groups = &overlap.summary.components;
    let alone: Vec<&str> =
        (0..cameras.len()).filter(|&i| groups[overlap.component[i]] == 1).map(name).collect();
    if !alone.is_empty() {
        let text = format!(
            "{} of {} frames share less than half of what they show with every other frame: {}; take more \
             photographs between \
             them",
            alone.len(),
            cameras.len(),
            listed(alone.iter())
        );
        findings.push(finding(Severity::Warning, "overlap", "overlap-none", text));
    }
    let large: Vec<usize> = groups.iter().copied().filter(|&size| size > 1).collect();
    if large.len() > 1 {
        let firsts =
            (0..large.len()).filter_map(|g| overlap.component.iter().position(|&group| group == g)).map(name);
        let text = format!(
            "the frames fall into {} groups that share too little to be joined, of {} frames; they begin \
             with {}: reconstruct them \
             one by one, or take photographs in between",
            large.len(),
            listed(large.iter()),
            listed(firsts)
        );
        findings.push(finding(Severity::Warning, "overlap", "overlap-groups", text));
    }
    if groups.len() == 1 {
        let text = format!(
            "all frames hang together; half of them share half of their content with {} others or more",
            overlap.summary.partners
        );
        findings.push(finding(Severity::Ok, "overlap", "overlap", text));
    }
    Some(overlap)
}
