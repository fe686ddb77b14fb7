//! Whether a result can be right. Engines do not notice that they are lost.

use crate::engine::{Solution, Task};
use crate::focal::uncertainties;
use crate::turned::turned;
use crate::{CameraGroup, Result};
use check_data::{CheckSettings, check_data};
use glam::DVec3;
use serde::Serialize;
use std::path::Path;
use view_data::{PosedFrame, open_nerfstudio, write_posed};

/// What was measured of a result, and what speaks against it. Pixels are those of pictures of 480 pixels on the long side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Photographs that were given to the engine.
    pub photographs: usize,
    /// Photographs that have a pose.
    pub registered: usize,
    /// Points.
    pub points: usize,
    /// Focal length of each camera, long sides of the picture; none of cameras without posed photographs.
    pub focal_lengths: Vec<Option<f64>>,
    /// Standard deviation of each, over the focal length; infinite (null in JSON) where nothing tells it.
    pub focal_deviations: Vec<Option<f64>>,
    /// Median over the points of their mean reprojection error, pixels.
    pub reprojection: Option<f64>,
    /// Symmetric epipolar distance that 90 % of the matches are under, pixels. The matches were found without the poses and without the
    /// engine. None where too few photographs could be matched.
    pub epipolar: Option<f64>,
    /// Median over the points of the largest angle between two of their rays, degrees.
    pub parallax: Option<f64>,
    /// What speaks against it.
    pub doubts: Vec<Doubt>,
}

/// What speaks against a result.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Doubt {
    /// Fewer than two photographs have a pose.
    #[error("{registered} of {photographs} photographs have a pose")]
    None {
        /// With a pose.
        registered: usize,
        /// All.
        photographs: usize,
    },
    /// Photographs are left out.
    #[error(
        "only {registered} of {photographs} photographs have a pose: the others do not overlap with them enough, or show another scene"
    )]
    Share {
        /// With a pose.
        registered: usize,
        /// All.
        photographs: usize,
    },
    /// No lens has this focal length.
    #[error("a focal length of {found:.2} long sides of the picture, expected {} to {}", FOCAL[0], FOCAL[1])]
    Focal {
        /// Long sides.
        found: f64,
    },
    /// The photographs hardly tell it, and there are no EXIF data.
    #[error("{}", uncertain(*deviation))]
    FocalUncertain {
        /// Standard deviation over the focal length, in first order; the error may be several times as large.
        deviation: f64,
    },
    /// Two engines that posed most photographs find different ones.
    #[error(
        "a focal length of {found:.2} long sides of the picture where {engine} finds {other:.2}: the photographs do not tell it; use photographs with EXIF data"
    )]
    FocalDisputed {
        /// Long sides.
        found: f64,
        /// Long sides.
        other: f64,
        /// The other engine.
        engine: &'static str,
    },
    /// EXIF data say otherwise.
    #[error("a focal length of {found:.2} long sides of the picture where EXIF data say {expected:.2}")]
    Exif {
        /// Long sides.
        found: f64,
        /// Long sides.
        expected: f64,
    },
    /// Points are not seen where they should be.
    #[error("a median reprojection error of {found:.2} px at 480 px, expected at most {REPROJECTION}")]
    Reprojection {
        /// Pixels.
        found: f64,
    },
    /// Matches contradict the poses.
    #[error(
        "matches contradict the poses: 90 % of the epipolar distances are under {found:.1} px at 480 px, expected at most {EPIPOLAR}"
    )]
    Epipolar {
        /// Pixels.
        found: f64,
    },
    /// Matches contradict the poses of some photographs, while most fit.
    #[error(
        "matches contradict the poses of {}: they come from another camera or zoom, or show something that moved",
        named(photographs, pairs)
    )]
    Misfits {
        /// Photographs that do not fit the others.
        photographs: Vec<String>,
        /// Pairs that do not fit each other, of which it is not known which is wrong.
        pairs: Vec<[String; 2]>,
    },
    /// Nothing could be compared.
    #[error("too few matches were found to check the poses")]
    Unchecked,
    /// The camera turned and did not move.
    #[error(
        "the camera turned and hardly moved: points are seen under {degrees:.2} degrees, expected at least {PARALLAX}"
    )]
    Parallax {
        /// Degrees.
        degrees: f64,
    },
    /// A camera that stays where it is explains the photographs as well.
    #[error(
        "the camera turned and hardly moved: without any movement 90 % of the matches are explained to {found:.1} px at 480 px, expected more than {TURNED}"
    )]
    Turned {
        /// Pixels.
        found: f64,
    },
}

fn uncertain(deviation: f64) -> String {
    if deviation.is_finite() {
        let (found, most) = (100.0 * deviation, 100.0 * UNCERTAIN);
        return format!(
            "the focal length is uncertain by {found:.1} %, expected at most {most} %; matches are few, or the camera looks the same way all along"
        );
    }
    "nothing tells the focal length".to_owned()
}

/// Names of photographs, and of pairs.
fn named(photographs: &[String], pairs: &[[String; 2]]) -> String {
    const SHOWN: usize = 4;
    let pairs = pairs.iter().map(|[a, b]| format!("{a} or {b}"));
    let all: Vec<String> = photographs.iter().cloned().chain(pairs).collect();
    let more = all.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", all[..all.len().min(SHOWN)].join(", "))
}

/// Share of the photographs that has to have a pose.
const SHARE: f64 = 0.8;
/// Focal lengths of usual lenses, long sides of the picture.
const FOCAL: [f64; 2] = [0.4, 3.0];
/// Share by which a focal length may differ from the one by EXIF data, which is rounded, and taken at infinity.
const EXIF: f64 = 0.2;
/// Factor between the focal lengths of two engines from which on neither is trusted.
const DISPUTED: f64 = 1.1;
/// Sets of photographs have 0.0003 to 0.0025, six of them up to 0.017, and a walk past houses whose focal length came out 58 % too long 0.028.
const UNCERTAIN: f64 = 0.02;
/// Good results have 0.1 to 0.5 px, lost ones 0.6 and more.
const REPROJECTION: f64 = 0.6;
/// Good results have 0.5 to 1 px, lost ones 3 and more (measured on nine sets of photographs).
const EPIPOLAR: f64 = 2.0;
/// From here on poses serve for nothing.
const HOPELESS: f64 = 8.0;
/// Measurement noise of a pixel is 0.1 to 0.2 degrees.
const PARALLAX: f64 = 0.7;
/// Cameras that turned in one place gave 1.2 to 2.5 px, sets of photographs from different places 15 px and more. Pixels at 480 px.
pub(crate) const TURNED: f64 = 3.0;
/// Pairs of photographs that are matched for the check.
const PAIRS: usize = 120;
/// Long side to which distances are scaled, pixels.
const LONG_SIDE: f64 = 480.0;

impl Doubt {
    /// Whether a result with this doubt serves for nothing.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        match self {
            Self::None { .. } | Self::Parallax { .. } | Self::Turned { .. } => true,
            Self::Epipolar { found } => *found > HOPELESS,
            _ => false,
        }
    }
}

impl Verdict {
    /// Whether the result serves for nothing.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        self.doubts.iter().any(Doubt::is_fatal)
    }

    /// Compares focal lengths that EXIF data do not give with what another engine found, if its result is sound and both posed photographs enough.
    pub(crate) fn dispute(&mut self, engine: &'static str, other: &Self, cameras: &[CameraGroup]) {
        let poses_most = |verdict: &Self| verdict.registered as f64 >= SHARE * verdict.photographs as f64;
        let is_unsound = |doubt: &Doubt| {
            matches!(doubt, Doubt::Focal { .. } | Doubt::Reprojection { .. } | Doubt::Epipolar { .. })
        };
        if !poses_most(self) || !poses_most(other) || other.is_fatal() || other.doubts.iter().any(is_unsound)
        {
            return;
        }
        let pairs = self.focal_lengths.iter().zip(&other.focal_lengths).zip(cameras);
        let pairs = pairs.filter(|(_, camera)| camera.focal_pixels.is_none());
        let apart = pairs.filter_map(|((found, other), _)| Some(((*found)?, (*other)?)));
        let far = |(found, other): &(f64, f64)| (found / other).ln().abs() > DISPUTED.ln();
        if let Some((found, other)) = apart.into_iter().find(far) {
            self.doubts.push(Doubt::FocalDisputed { found, other, engine });
        }
    }

    /// Positions of the posed photographs whose poses the matches contradict.
    pub(crate) fn misfits(&self, task: &Task<'_>, solution: &Solution) -> Vec<usize> {
        let names = self.doubts.iter().filter_map(|doubt| match doubt {
            Doubt::Misfits { photographs, .. } => Some(photographs),
            _ => None,
        });
        let names: Vec<&String> = names.flatten().collect();
        let is_misfit = |&index: &usize| {
            solution.poses[index].is_some() && names.contains(&&task.photographs[index].name)
        };
        (0..task.photographs.len()).filter(is_misfit).collect()
    }

    /// Whether this result is to be preferred: one that serves, then fewer doubts, more photographs, smaller distances.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        let distance = |verdict: &Self| verdict.epipolar.unwrap_or(f64::MAX);
        let key = |verdict: &Self| {
            (!verdict.is_fatal(), std::cmp::Reverse(verdict.doubts.len()), verdict.registered)
        };
        key(self).cmp(&key(other)).then(distance(other).total_cmp(&distance(self))).is_gt()
    }
}

/// Judges a solution, whose data set is written into `folder`, beside the pictures, on the way.
pub(crate) fn judge(solution: &Solution, task: &Task<'_>, folder: &Path) -> Result<Verdict> {
    let (photographs, registered) = (task.photographs.len(), solution.registered());
    let mut verdict = Verdict {
        photographs,
        registered,
        points: solution.points.len(),
        focal_lengths: vec![None; task.cameras.len()],
        focal_deviations: Vec::new(),
        reprojection: None,
        epipolar: None,
        parallax: parallax(solution),
        doubts: Vec::new(),
    };
    if registered < crate::error::MINIMUM {
        verdict.doubts.push(Doubt::None { registered, photographs });
        return Ok(verdict);
    }
    if (registered as f64) < SHARE * photographs as f64 {
        verdict.doubts.push(Doubt::Share { registered, photographs });
    }
    verdict.focal_deviations = uncertainties(solution, task.photographs);
    for (number, (lens, group)) in solution.lenses.iter().zip(task.cameras).enumerate() {
        let is_used =
            |index: usize| solution.poses[index].is_some() && task.photographs[index].camera == number;
        if !(0..photographs).any(is_used) {
            continue;
        }
        let long = group.width.max(group.height) as f64;
        let found = lens.intrinsics.fx / long;
        verdict.focal_lengths[number] = Some(found);
        if let Some(expected) = group.focal_pixels.map(|focal| focal / long)
            && (found / expected - 1.0).abs() > EXIF
        {
            verdict.doubts.push(Doubt::Exif { found, expected });
        } else if !(FOCAL[0]..=FOCAL[1]).contains(&found) {
            verdict.doubts.push(Doubt::Focal { found });
        }
    }
    let without_exif = task.cameras.iter().zip(&verdict.focal_deviations);
    let without_exif = without_exif.filter(|(group, _)| group.focal_pixels.is_none());
    let worst = without_exif.filter_map(|(_, deviation)| *deviation).max_by(f64::total_cmp);
    if let Some(deviation) = worst.filter(|deviation| *deviation > UNCERTAIN) {
        verdict.doubts.push(Doubt::FocalUncertain { deviation });
    }
    let sides = task.photographs.iter().map(|photograph| photograph.width.max(photograph.height));
    let to_480 = LONG_SIDE / sides.max().unwrap_or(1) as f64;
    verdict.reprojection =
        median(solution.points.iter().filter_map(|point| point.error)).map(|px| px * to_480);
    if let Some(found) = verdict.reprojection.filter(|found| *found > REPROJECTION) {
        verdict.doubts.push(Doubt::Reprojection { found });
    }
    if let Some(degrees) = verdict.parallax.filter(|degrees| *degrees < PARALLAX) {
        verdict.doubts.push(Doubt::Parallax { degrees });
    } else if let Some(found) = turned(solution, task.photographs).map(|px| px * LONG_SIDE)
        && found < TURNED
    {
        verdict.doubts.push(Doubt::Turned { found });
    }

    write_data_set(solution, task, folder)?;
    let dataset = open_nerfstudio(folder)?;
    let settings = CheckSettings { pairs: PAIRS, thumbnails: 0, seed: task.seed, ..CheckSettings::default() };
    let report = check_data(&dataset, &settings, |_| ())?;
    let p90 = report.poses.readings.first().and_then(|as_read| as_read.p90);
    verdict.epipolar = p90.map(|p90| p90 * report.poses.reduction.max(1) as f64 * to_480);
    match verdict.epipolar {
        Some(found) if found > EPIPOLAR => verdict.doubts.push(Doubt::Epipolar { found }),
        Some(_) => {}
        None => verdict.doubts.push(Doubt::Unchecked),
    }
    let check_data::PoseSummary { misfits, unsure, .. } = report.poses;
    if !(misfits.is_empty() && unsure.is_empty()) {
        // Frames are named otherwise than their files.
        let file = |name: &String| {
            let frame = dataset.frames.iter().find(|frame| frame.name == *name);
            let file = frame.and_then(|frame| frame.image.path().file_name());
            file.map_or_else(|| name.clone(), |file| file.to_string_lossy().into_owned())
        };
        let photographs = misfits.iter().map(file).collect();
        let pairs = unsure.iter().map(|pair| pair.each_ref().map(file)).collect();
        verdict.doubts.push(Doubt::Misfits { photographs, pairs });
    }
    Ok(verdict)
}

/// `transforms.json` and COLMAP's model for the photographs that have a pose.
pub(crate) fn write_data_set(solution: &Solution, task: &Task<'_>, folder: &Path) -> Result<()> {
    let mut frames = Vec::new();
    let mut position_of = vec![None; task.photographs.len()];
    for (index, photograph) in task.photographs.iter().enumerate() {
        if let Some((lens, camera)) = solution.camera(task.photographs, index) {
            position_of[index] = Some(frames.len());
            frames.push(PosedFrame { picture: photograph.name.clone(), lens, camera });
        }
    }
    let mut points = solution.points.clone();
    for point in &mut points {
        point.observations.retain_mut(|seen| {
            position_of[seen.frame].is_some_and(|position| {
                seen.frame = position;
                true
            })
        });
    }
    write_posed(folder, &frames, &points)?;
    Ok(())
}

/// Median over the points of the largest angle between two of their rays, degrees.
fn parallax(solution: &Solution) -> Option<f64> {
    let angle = |point: &view_data::ScenePoint| {
        let rays = point.observations.iter().filter_map(|seen| solution.poses[seen.frame]);
        let rays: Vec<DVec3> = rays.map(|pose| (point.position - pose.position).normalize()).collect();
        let pairs =
            rays.iter().enumerate().flat_map(|(i, a)| rays[i + 1..].iter().map(move |b| a.angle_between(*b)));
        pairs.fold(0.0, f64::max).to_degrees()
    };
    median(solution.points.iter().map(angle))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(registered: usize, focal: [Option<f64>; 2]) -> Verdict {
        Verdict {
            photographs: 10,
            registered,
            points: 100,
            focal_lengths: focal.to_vec(),
            focal_deviations: vec![None; 2],
            reprojection: None,
            epipolar: None,
            parallax: None,
            doubts: Vec::new(),
        }
    }

    #[test]
    fn focal_lengths_of_two_engines_are_compared_camera_by_camera() {
        let camera = |focal_pixels| CameraGroup {
            width: 8,
            height: 6,
            name: None,
            focal_mm: None,
            focal_pixels,
            photographs: 5,
        };
        let doubts = |focals: [Option<f64>; 2], other: &Verdict, exif| {
            let mut result = verdict(10, focals);
            result.dispute("other", other, &[camera(exif), camera(None)]);
            result.doubts.len()
        };
        let focals = [Some(0.8), None];
        assert_eq!(doubts(focals, &verdict(10, [Some(0.85), Some(2.0)]), None), 0);
        assert_eq!(doubts(focals, &verdict(10, [Some(1.2), None]), None), 1);
        assert_eq!(doubts([None, Some(0.8)], &verdict(9, [Some(0.8), Some(0.6)]), None), 1);
        // Known by EXIF data; too few photographs; a result that is not sound, or lost.
        assert_eq!(doubts(focals, &verdict(10, [Some(1.2), None]), Some(6.4)), 0);
        assert_eq!(doubts(focals, &verdict(7, [Some(1.2), None]), None), 0);
        for doubt in [Doubt::Turned { found: 1.0 }, Doubt::Epipolar { found: 3.0 }] {
            let mut unsound = verdict(10, [Some(1.2), None]);
            unsound.doubts.push(doubt);
            assert_eq!(doubts(focals, &unsound, None), 0);
        }
        let mut uncertain = verdict(10, [Some(1.2), None]);
        uncertain.doubts.push(Doubt::FocalUncertain { deviation: 0.03 });
        assert_eq!(doubts(focals, &uncertain, None), 1);
    }

    #[test]
    fn what_contradicts_the_poses_is_named_with_a_limit() {
        let pair = ["a", "b"].map(str::to_owned);
        let doubt = Doubt::Misfits { photographs: vec!["x".to_owned()], pairs: vec![pair; 6] };
        let text = doubt.to_string();
        assert!(text.contains("the poses of x, a or b, a or b, a or b and 3 more:"), "{text}");
        let uncertain = |deviation| Doubt::FocalUncertain { deviation }.to_string();
        assert!(
            uncertain(0.0278).contains("uncertain by 2.8 %, expected at most 2 %"),
            "{}",
            uncertain(0.0278)
        );
        assert!(uncertain(f64::INFINITY).contains("nothing tells the focal length"));
    }
}
