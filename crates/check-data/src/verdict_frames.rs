//! Findings about single frames whose pictures do not fit their poses, while other frames do.

use super::epipolar::Posed;
use super::readings::{PairMatches, Tally, median};
use super::report::{Finding, Severity};
use super::verdict_poses::{Evidence, Judged};
use super::{finding, listed};
use std::collections::BTreeSet;

/// Median distance of a frame's matches over that of all, and in pixels, from which on the frame is wrong.
const FRAME_RATIO: f64 = 6.0;
const FRAME_PIXELS: f64 = 1.0;
/// From here on nothing but a wrong pose explains it, pixels.
const FRAME_WRONG: f64 = 3.0;
/// Frames whose poses are exchanged in trial, at most.
const MAX_SUSPECTS: usize = 12;

fn pair_median(posed: &[Option<Posed>], pair: &PairMatches) -> Option<f64> {
    let mut tally = Tally::default();
    tally.add(posed[pair.first].as_ref()?, posed[pair.second].as_ref()?, &pair.matches);
    tally.quantiles().0
}

pub(crate) fn medians_of_frames(posed: &[Option<Posed>], pairs: &[PairMatches]) -> Vec<Option<f64>> {
    let mut all: Vec<Vec<f64>> = vec![Vec::new(); posed.len()];
    for pair in pairs {
        if let Some(value) = pair_median(posed, pair) {
            all[pair.first].push(value);
            all[pair.second].push(value);
        }
    }
    all.into_iter().map(median).collect()
}

/// Names the frames whose matches do not fit while the others' do, and says which two are exchanged.
pub(crate) fn judge_frames(evidence: &Evidence, judged: &mut Judged, findings: &mut Vec<Finding>) {
    let Evidence { dataset, posed, pairs, .. } = *evidence;
    let Some(typical) = median(judged.medians.iter().flatten().copied().collect()) else { return };
    let bound = (FRAME_RATIO * typical).max(FRAME_PIXELS);
    let mut left: Vec<(&PairMatches, f64)> =
        pairs.iter().filter_map(|pair| Some((pair, pair_median(posed, pair)?))).collect();
    // With one pair it is either of the two frames.
    let mut total = vec![0usize; posed.len()];
    left.iter().for_each(|(pair, _)| [pair.first, pair.second].iter().for_each(|&i| total[i] += 1));
    let mut suspects: Vec<usize> = Vec::new();
    loop {
        // The frame with the largest share of bad pairs; its pairs then no longer speak against others.
        let mut counts = vec![(0usize, 0usize); posed.len()];
        for (pair, median) in &left {
            for i in [pair.first, pair.second] {
                counts[i].0 += usize::from(*median > bound);
                counts[i].1 += 1;
            }
        }
        let share = |i: usize| counts[i].0 as f64 / counts[i].1.max(1) as f64;
        let worst = (0..posed.len()).filter(|&i| total[i] > 1 && share(i) > 0.5).max_by(|&a, &b| {
            share(a).total_cmp(&share(b)).then(counts[a].0.cmp(&counts[b].0)).then(b.cmp(&a))
        });
        let Some(worst) = worst else { break };
        suspects.push(worst);
        left.retain(|(pair, _)| pair.first != worst && pair.second != worst);
    }
    let name = |i: usize| dataset.frames[i].name.as_str();
    let off = left.iter().filter(|(_, median)| *median > bound);
    judged.summary.unsure =
        off.map(|(pair, _)| [pair.first, pair.second].map(|i| name(i).to_owned())).collect();
    if !judged.summary.unsure.is_empty() {
        let unsure: Vec<String> = judged.summary.unsure.iter().map(|pair| pair.join(" and ")).collect();
        let text = format!(
            "in {} pairs of frames the pictures do not fit the poses, and too few pairs were matched to say \
             which of the two is \
             wrong: {}; look at them, or ask for more pairs",
            unsure.len(),
            listed(unsure)
        );
        findings.push(finding(Severity::Warning, "poses", "pair-pose", text));
    }
    let mut named = BTreeSet::new();
    if suspects.len() <= MAX_SUSPECTS {
        for (k, &a) in suspects.iter().enumerate() {
            for &b in &suspects[k + 1..] {
                if !named.contains(&a) && !named.contains(&b) && exchanged(posed, pairs, a, b, bound) {
                    let (first, second) = (&dataset.frames[a.min(b)], &dataset.frames[a.max(b)]);
                    let text = format!(
                        "the pictures of {} and {} fit each other's poses: exchange the two files",
                        first.name, second.name
                    );
                    let place = format!("{} ({})", first.image, first.name);
                    findings.push(finding(Severity::Error, place, "frames-exchanged", text));
                    named.extend([a, b]);
                }
            }
        }
    }
    suspects.sort_unstable();
    judged.summary.misfits = suspects.iter().map(|&i| name(i).to_owned()).collect();
    for i in suspects.into_iter().filter(|i| !named.contains(i)) {
        let frame = &dataset.frames[i];
        let value = judged.medians[i].unwrap_or(f64::INFINITY);
        let severity = if value > FRAME_WRONG { Severity::Error } else { Severity::Warning };
        let text = format!(
            "the picture of {} does not fit its pose: epipolar distance {value:.1} px (median of its pairs), \
             {typical:.2} px \
             for most frames; wrong file, wrong pose, or something that moved: remove the frame",
            frame.name
        );
        findings.push(finding(severity, format!("{} ({})", frame.image, frame.name), "frame-pose", text));
    }
}

/// Whether the pairs of two frames fit once these have each other's poses.
fn exchanged(posed: &[Option<Posed>], pairs: &[PairMatches], a: usize, b: usize, bound: f64) -> bool {
    let mut trial = posed.to_vec();
    trial.swap(a, b);
    let medians = |frame: usize, poses: &[Option<Posed>]| {
        let frame_pairs = pairs.iter().filter(|pair| pair.first == frame || pair.second == frame);
        median(frame_pairs.filter_map(|pair| pair_median(poses, pair)).collect())
    };
    [a, b].into_iter().all(|frame| medians(frame, &trial).is_some_and(|value| value <= bound))
}

/// What no match speaks for is said.
pub(crate) fn judge_unchecked(evidence: &Evidence, judged: &Judged, findings: &mut Vec<Finding>) {
    let usable = evidence.posed.iter().flatten().count();
    let unmatched =
        (0..evidence.posed.len()).filter(|&i| evidence.posed[i].is_some() && judged.matches[i] == 0);
    let names: Vec<&str> = unmatched.map(|i| evidence.dataset.frames[i].name.as_str()).collect();
    if !names.is_empty() {
        let text = format!(
            "the poses of {} of {usable} frames were not checked: {}; {} pairs of pictures were matched ({} \
             without success), \
             more can be asked for",
            names.len(),
            listed(names.iter()),
            evidence.tried,
            evidence.tried - evidence.pairs.len()
        );
        findings.push(finding(Severity::Note, "poses", "poses-unchecked", text));
    }
}
