//! Findings about the poses: which reading of them fits the pictures, and which frames do not.

use super::epipolar::Posed;
use super::finding;
use super::readings::{PairMatches, best_focal_factor, score};
use super::report::{Finding, PoseSummary, Reading, ReadingScore, Severity};
use super::verdict_frames::{judge_frames, judge_unchecked, medians_of_frames};
use view_data::{Dataset, Format};

/// Matches and pairs from which on something can be said.
const MIN_MATCHES: usize = 120;
const MIN_PAIRS: usize = 2;
/// Median epipolar distances, pixels: of good poses, and of poses that are of no use.
const GOOD: f64 = 0.8;
const POOR: f64 = 1.6;
/// Another reading explains the matches if its median is so much smaller.
const EXPLAINS: f64 = 0.4;
/// Another reading is as good if its median is at most so much greater.
const AS_GOOD: f64 = 1.5;
/// Share of the matches in front of both cameras from which on a reading makes sense.
const IN_FRONT: f64 = 0.6;
/// A focal length fits better if the median with it is so much smaller.
const FOCAL_GAIN: f64 = 0.6;

/// What is known for judging the poses.
pub(crate) struct Evidence<'a> {
    pub(crate) dataset: &'a Dataset,
    pub(crate) posed: &'a [Option<Posed>],
    pub(crate) tried: usize,
    pub(crate) pairs: &'a [PairMatches],
    pub(crate) reduction: usize,
}

/// What the poses turned out to be.
pub(crate) struct Judged {
    pub(crate) summary: PoseSummary,
    /// Per frame: median distance of its matches as read.
    pub(crate) medians: Vec<Option<f64>>,
    /// Per frame: matches.
    pub(crate) matches: Vec<usize>,
    /// Whether the poses as read fit.
    pub(crate) fit: bool,
}

pub(crate) fn judge_poses(evidence: &Evidence, findings: &mut Vec<Finding>) -> Judged {
    let Evidence { posed, pairs, .. } = *evidence;
    let matches: usize = pairs.iter().map(|pair| pair.matches.len()).sum();
    let mut of_frame = vec![0; posed.len()];
    for pair in pairs {
        of_frame[pair.first] += pair.matches.len();
        of_frame[pair.second] += pair.matches.len();
    }
    let mut judged = Judged {
        summary: PoseSummary {
            pairs_tried: evidence.tried,
            pairs: pairs.len(),
            frames: of_frame.iter().filter(|count| **count > 0).count(),
            matches,
            reduction: evidence.reduction,
            ..PoseSummary::default()
        },
        medians: medians_of_frames(posed, pairs),
        matches: of_frame,
        fit: false,
    };
    if matches < MIN_MATCHES || pairs.len() < MIN_PAIRS {
        let text = format!(
            "{matches} matches in {} of {} pairs of pictures are too few to tell whether the poses fit (at \
             least \
             {MIN_MATCHES} in {MIN_PAIRS} pairs are needed): the pictures overlap too little, show nothing \
             that can be \
             matched, or belong to other poses",
            pairs.len(),
            evidence.tried
        );
        findings.push(finding(Severity::Warning, "poses", "too-few-matches", text));
        return judged;
    }
    let scores: Vec<ReadingScore> =
        Reading::ALL.iter().map(|&reading| score(reading, posed, pairs)).collect();
    judged.fit = judge_readings(evidence, &scores, &mut judged.summary, findings);
    // Against poses that are all poor no single frame stands out.
    if judged.fit && scores[0].median.is_some_and(|here| here <= GOOD) {
        judge_frames(evidence, &mut judged, findings);
    }
    judged.summary.readings = scores;
    judge_unchecked(evidence, &judged, findings);
    judged
}

/// Says which reading fits; whether the one as read does.
fn judge_readings(
    evidence: &Evidence,
    scores: &[ReadingScore],
    summary: &mut PoseSummary,
    findings: &mut Vec<Finding>,
) -> bool {
    let as_read = scores[0];
    let here = as_read.median.unwrap_or(f64::INFINITY);
    let sensible = |score: &&ReadingScore| score.in_front.is_none_or(|share| share >= IN_FRONT);
    let distance = |score: &ReadingScore| score.median.unwrap_or(f64::INFINITY);
    let best = scores[1..].iter().filter(sensible).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let faces_away = !sensible(&&as_read);
    let figures = format!(
        "epipolar distance {} px (median / 90 %) over {} matches of {} pairs{}",
        pair_of(as_read.median, as_read.p90),
        summary.matches,
        summary.pairs,
        if evidence.reduction > 1 {
            format!(", in pictures reduced {} times", evidence.reduction)
        } else {
            String::new()
        }
    );
    let explains = |score: &ReadingScore| {
        // Where the scene lies behind the cameras as read, a reading that is equal otherwise is better.
        let bound = if faces_away { AS_GOOD * here.max(GOOD / AS_GOOD) } else { EXPLAINS * here };
        distance(score) <= bound && distance(score) <= POOR && (here > GOOD || faces_away)
    };
    if let Some(best) = best.filter(|score| explains(score)) {
        let text = format!(
            "the pictures do not fit the poses as read ({figures}), but {} px if {}: {}",
            pair_of(best.median, best.p90),
            meaning(best.reading),
            remedy(best.reading, evidence.dataset.format)
        );
        findings.push(finding(Severity::Error, "poses", "pose-convention", text));
        return false;
    }
    if faces_away {
        let share = as_read.in_front.unwrap_or(0.0);
        let text = format!(
            "{:.0} % of the matches would lie behind the cameras as read ({figures}), and no usual \
             misreading explains it; are \
             pictures mirrored, or camera axes mixed?",
            100.0 * (1.0 - share)
        );
        findings.push(finding(Severity::Error, "poses", "pose-behind", text));
        return false;
    }
    judge_focal(evidence, here, summary, findings);
    if here > POOR {
        let closest = best.map_or_else(String::new, |score| {
            format!(" (the closest: {}, {} px)", meaning(score.reading), pair_of(score.median, score.p90))
        });
        let text = format!(
            "the poses or intrinsics are inaccurate: {figures}; good ones give less than {GOOD} px, and no \
             usual misreading \
             explains it{closest}; estimate the poses again (COLMAP), or check that pictures and poses \
             belong together"
        );
        findings.push(finding(Severity::Error, "poses", "pose-accuracy", text));
        return false;
    }
    if here > GOOD {
        let text = format!(
            "the poses fit, but not well: {figures}, good ones give less than {GOOD} px; check the \
             intrinsics and the \
             distortion, or estimate the poses again (COLMAP)"
        );
        findings.push(finding(Severity::Warning, "poses", "pose-accuracy", text));
    } else {
        let others = scores[1..].iter().filter(sensible).map(distance).fold(f64::INFINITY, f64::min);
        let margin = if others.is_finite() {
            format!("; the best of {} usual misreadings gives {others:.1} px", scores.len() - 1)
        } else {
            String::new()
        };
        let text = format!(
            "the poses are right as read: {figures}{margin}. Half a pixel is too little to be seen this way"
        );
        findings.push(finding(Severity::Ok, "poses", "pose-convention", text));
    }
    let alike: Vec<&str> = scores[1..]
        .iter()
        .filter(sensible)
        .filter(|score| distance(score) <= AS_GOOD * here)
        .map(|score| meaning(score.reading))
        .collect();
    if !alike.is_empty() {
        let text = format!(
            "these camera positions cannot tell the poses as read from other readings that fit as well: {}; \
             look at a \
             result before you trust it",
            alike.join("; ")
        );
        findings.push(finding(Severity::Note, "poses", "pose-ambiguous", text));
    }
    true
}

fn judge_focal(evidence: &Evidence, here: f64, summary: &mut PoseSummary, findings: &mut Vec<Finding>) {
    let Some([factor, median]) = best_focal_factor(evidence.posed, evidence.pairs) else { return };
    if median > FOCAL_GAIN * here || (factor - 1.0).abs() < 0.03 || here < 0.5 * GOOD {
        return;
    }
    summary.focal_factor = Some([factor, median]);
    let text = format!(
        "the matches fit better with {factor:.2} times the focal length ({median:.2} px instead of \
         {here:.2}): are the \
         intrinsics those of these pictures?"
    );
    findings.push(finding(Severity::Warning, "intrinsics", "focal-length", text));
}

fn pair_of(median: Option<f64>, p90: Option<f64>) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    format!("{} / {}", number(median), number(p90))
}

fn meaning(reading: Reading) -> &'static str {
    match reading {
        Reading::AsRead => "the poses are as read",
        Reading::OtherAxes => {
            "y and z of the camera axes are flipped (OpenGL taken for OpenCV, or the other way about)"
        }
        Reading::Inverse => {
            "the matrices are the inverse (world-to-camera taken for camera-to-world, or the other way \
             about), with OpenCV axes"
        }
        Reading::InverseOtherAxes => {
            "the matrices are the inverse (world-to-camera taken for camera-to-world, or the other way \
             about), with OpenGL axes"
        }
        Reading::YFlipped => "the y axis is flipped alone",
        Reading::UpsideDown => "the pictures stand on their heads",
        Reading::RotationTransposed => "the rotations are transposed",
        Reading::TranslationAsCentre => {
            "the translations are those of world-to-camera poses, not camera centres"
        }
        Reading::CentreNegated => "the camera centres have the wrong sign",
        Reading::PoseOfNext => "every picture has the pose of the frame after it",
        Reading::PoseOfPrevious => "every picture has the pose of the frame before it",
        Reading::HalfSize => "the intrinsics are for pictures of half the size",
        Reading::DoubleSize => "the intrinsics are for pictures of twice the size",
    }
}

fn remedy(reading: Reading, format: Format) -> String {
    let opengl = matches!(format, Format::Nerfstudio | Format::Dl3dv);
    let wanted = if opengl { "OpenGL (y up, z backward)" } else { "OpenCV (y down, z forward)" };
    let direction = match format {
        Format::Colmap | Format::Chunk | Format::Re10k => "world-to-camera",
        _ => "camera-to-world",
    };
    match reading {
        Reading::AsRead => String::new(),
        Reading::OtherAxes => {
            format!(
                "this layout wants {wanted} axes; negate columns 2 and 3 of every camera-to-world matrix \
             (rows 2 and 3 of a world-to-camera one)"
            )
        }
        Reading::Inverse | Reading::InverseOtherAxes => {
            let is = if reading == Reading::Inverse { "OpenCV" } else { "OpenGL" };
            format!(
                "this layout wants {direction} matrices with {wanted} axes; yours are the inverse, with \
             {is} axes"
            )
        }
        Reading::YFlipped => "negate the second row and the second column of every camera-to-world \
         matrix"
            .to_owned(),
        Reading::UpsideDown => "turn the pictures by 180 degrees (an EXIF rotation that was not applied?), \
         or negate \
             columns 1 and 2 of every camera-to-world matrix"
            .to_owned(),
        Reading::RotationTransposed => "transpose the 3x3 part of every matrix (row-major taken for \
         column-major?)"
            .to_owned(),
        Reading::TranslationAsCentre => "replace the translation t by the centre -R^T t, R being the \
         world-to-camera rotation"
            .to_owned(),
        Reading::CentreNegated => "negate the translation column".to_owned(),
        Reading::PoseOfNext | Reading::PoseOfPrevious => {
            "pictures and poses are off by one: check where numbering begins, and that the first or last \
             frame was not dropped \
             from one of them"
                .to_owned()
        }
        Reading::HalfSize => "multiply fx, fy, cx, cy by 2, or state the size that they are for".to_owned(),
        Reading::DoubleSize => "divide fx, fy, cx, cy by 2, or state the size that they are for".to_owned(),
    }
}
