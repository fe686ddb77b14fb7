//! Compares the poses as read, and their usual misreadings, with matches that were found without poses.

use super::epipolar::{Posed, fundamental, symmetric_distance, triangulate, turn_distance};
use super::matching::Match;
use super::report::{Reading, ReadingScore};
use glam::{DMat3, DVec3};
use gs_scene::Intrinsics;

/// The matches of two frames.
#[derive(Debug, Clone)]
pub(crate) struct PairMatches {
    /// Positions of the frames.
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) matches: Vec<Match>,
}

/// Axes of the camera with y and z the other way.
const OTHER_AXES: DMat3 = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));

impl Reading {
    /// All readings; the one as read comes first.
    pub(crate) const ALL: [Self; 13] = [
        Self::AsRead,
        Self::OtherAxes,
        Self::Inverse,
        Self::InverseOtherAxes,
        Self::YFlipped,
        Self::UpsideDown,
        Self::RotationTransposed,
        Self::TranslationAsCentre,
        Self::CentreNegated,
        Self::PoseOfNext,
        Self::PoseOfPrevious,
        Self::HalfSize,
        Self::DoubleSize,
    ];

    /// Frame `i` as it would be if the files meant this; `None` for a frame that has no pose then.
    pub(crate) fn of(self, posed: &[Option<Posed>], i: usize) -> Option<Posed> {
        let as_read = (*posed.get(i)?)?;
        let Posed { intrinsics, axes, position } = as_read;
        let with_pose = |axes, position| Some(Posed { intrinsics, axes, position });
        let inverse = axes.transpose();
        match self {
            Self::AsRead => Some(as_read),
            Self::OtherAxes => with_pose(axes * OTHER_AXES, position),
            Self::Inverse => with_pose(inverse, -(inverse * position)),
            // A reader that flips the axes of a camera-to-world matrix has flipped those of the world of an
            // inverse one, which changes nothing; what is missing is the flip of the camera's.
            Self::InverseOtherAxes => with_pose(inverse * OTHER_AXES, -(inverse * position)),
            Self::YFlipped => with_pose(axes * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)), position),
            Self::UpsideDown => {
                let turned = Intrinsics {
                    cx: intrinsics.width as f64 - intrinsics.cx,
                    cy: intrinsics.height as f64 - intrinsics.cy,
                    ..intrinsics
                };
                let axes = axes * DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
                Some(Posed { intrinsics: turned, axes, position })
            }
            Self::RotationTransposed => with_pose(inverse, position),
            // The centre c was read from a place that holds t = -R c.
            Self::TranslationAsCentre => with_pose(axes, -(axes * position)),
            Self::CentreNegated => with_pose(axes, -position),
            Self::PoseOfNext => neighbour(posed, i, 1, intrinsics),
            Self::PoseOfPrevious => neighbour(posed, i, -1, intrinsics),
            Self::HalfSize => Some(Posed { intrinsics: times(intrinsics, 2.0), axes, position }),
            Self::DoubleSize => Some(Posed { intrinsics: times(intrinsics, 0.5), axes, position }),
        }
    }
}

fn neighbour(posed: &[Option<Posed>], i: usize, offset: isize, intrinsics: Intrinsics) -> Option<Posed> {
    let Posed { axes, position, .. } = (*posed.get(i.checked_add_signed(offset)?)?)?;
    Some(Posed { intrinsics, axes, position })
}

fn times(intrinsics: Intrinsics, factor: f64) -> Intrinsics {
    let Intrinsics { fx, fy, cx, cy, width, height } = intrinsics;
    Intrinsics { fx: fx * factor, fy: fy * factor, cx: cx * factor, cy: cy * factor, width, height }
}

/// Distances and sides of matches under some poses.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tally {
    /// Symmetric epipolar distances, pixels.
    pub(crate) distances: Vec<f64>,
    /// Matches with a usable angle.
    angled: usize,
    /// Those of them in front of both cameras.
    in_front: usize,
}

/// Rays must differ by so much to tell what is in front from what is behind: half a degree, in radians.
const USABLE_ANGLE: f64 = 0.0087;

/// Centres so near to each other, relative to their distance from the origin, are one place.
const SAME_PLACE: f64 = 1e-9;

impl Tally {
    pub(crate) fn add(&mut self, first: &Posed, second: &Posed, matches: &[Match]) {
        let scale = first.position.length().max(second.position.length());
        let turned_only = first.position.distance(second.position) <= SAME_PLACE * scale;
        let matrix = fundamental(first, second);
        for found in matches {
            if turned_only {
                self.distances.push(turn_distance(first, second, found));
                continue;
            }
            self.distances.push(symmetric_distance(&matrix, found));
            let Some(point) = triangulate(first, second, found) else { continue };
            // Rays that nearly oppose each other are as useless as nearly parallel ones.
            if point.angle > USABLE_ANGLE && point.angle < std::f64::consts::PI - USABLE_ANGLE {
                self.angled += 1;
                self.in_front += usize::from(point.first > 0.0 && point.second > 0.0);
            }
        }
    }

    /// Median and 90 % of the distances; sorts them.
    pub(crate) fn quantiles(&mut self) -> (Option<f64>, Option<f64>) {
        self.distances.sort_by(f64::total_cmp);
        let distance = |share: f64| quantile(&self.distances, share);
        (distance(0.5), distance(0.9))
    }

    fn share_in_front(&self) -> Option<f64> {
        (self.angled >= MIN_ANGLED).then(|| self.in_front as f64 / self.angled as f64)
    }
}

const MIN_ANGLED: usize = 20;

/// The value that a share of a sorted list does not exceed.
pub(crate) fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((share * last as f64).round() as usize).copied()
}

/// Median of values in any order.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    quantile(&values, 0.5)
}

/// How well a reading fits.
pub(crate) fn score(reading: Reading, posed: &[Option<Posed>], pairs: &[PairMatches]) -> ReadingScore {
    let mut tally = Tally::default();
    for pair in pairs {
        let (first, second) = (reading.of(posed, pair.first), reading.of(posed, pair.second));
        if let (Some(first), Some(second)) = (first, second) {
            tally.add(&first, &second, &pair.matches);
        }
    }
    let (median, p90) = tally.quantiles();
    ReadingScore { reading, median: finite(median), p90: finite(p90), in_front: tally.share_in_front() }
}

/// JSON has no infinity.
fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|value| value.is_finite())
}

/// The factor on all focal lengths that fits best, and the median distance with it.
pub(crate) fn best_focal_factor(posed: &[Option<Posed>], pairs: &[PairMatches]) -> Option<[f64; 2]> {
    let scaled = |factor: f64| -> Option<f64> {
        let zoomed = |i: usize| {
            let mut one = posed[i]?;
            one.intrinsics.fx *= factor;
            one.intrinsics.fy *= factor;
            Some(one)
        };
        let mut tally = Tally::default();
        for pair in pairs {
            if let (Some(first), Some(second)) = (zoomed(pair.first), zoomed(pair.second)) {
                tally.add(&first, &second, &pair.matches);
            }
        }
        tally.quantiles().0
    };
    // Half to double in steps of 6 %.
    let factors = (-12i32..=12).map(|step| 2f64.powf(f64::from(step) / 12.0));
    let tried = factors.filter_map(|factor| Some([factor, scaled(factor)?]));
    tried.min_by(|a, b| a[1].total_cmp(&b[1]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Cameras on a bent path around the origin, turned all ways a hand turns them.
    pub(crate) fn path(count: usize) -> Vec<Posed> {
        let intrinsics = Intrinsics { fx: 300.0, fy: 305.0, cx: 155.0, cy: 125.0, width: 320, height: 240 };
        let camera = |i: usize| {
            let t = i as f64 / count as f64;
            let position =
                DVec3::new(3.0 * (1.5 * t).sin(), 0.4 * (7.0 * t).sin() + 1.0, -4.0 * (1.5 * t).cos());
            let z = (DVec3::new(0.2, 0.1, 0.3 * t) - position).normalize();
            let x = DVec3::new(0.1 * (9.0 * t).sin(), 1.0, 0.05).cross(z).normalize();
            Posed { intrinsics, axes: DMat3::from_cols(x, z.cross(x), z), position }
        };
        (0..count).map(camera).collect()
    }

    /// What the cameras see of points around the origin, without noise.
    pub(crate) fn sightings(cameras: &[Posed]) -> Vec<PairMatches> {
        let point = |k: usize| {
            let f = |m: usize| ((k * m) % 97) as f64 / 97.0 - 0.5;
            DVec3::new(3.0 * f(13), 2.0 * f(29), 2.0 * f(41))
        };
        let pair = |i: usize, j: usize| {
            let found =
                |k| Match { first: cameras[i].project(point(k)), second: cameras[j].project(point(k)) };
            PairMatches { first: i, second: j, matches: (0..60).map(found).collect() }
        };
        (1..cameras.len()).flat_map(|j| [pair(j - 1, j), pair(j.saturating_sub(3), j)]).collect()
    }

    fn misread(truth: &[Posed], reading: Reading) -> Option<Vec<Option<Posed>>> {
        // The mistake is the inverse of its repair.
        let repaired: Vec<Option<Posed>> = truth.iter().copied().map(Some).collect();
        let undone = |i: usize| -> Option<Posed> {
            let Posed { axes, position, .. } = truth[i];
            match reading {
                // Repair: A' = Aᵀ F, p' = -Aᵀ p. So A = F A'ᵀ, p = -A p'.
                Reading::InverseOtherAxes => {
                    let wrong = OTHER_AXES * axes.transpose();
                    Some(Posed { axes: wrong, position: -(wrong * position), ..truth[i] })
                }
                // p' = -A p.
                Reading::TranslationAsCentre => {
                    Some(Posed { position: -(axes.transpose() * position), ..truth[i] })
                }
                Reading::PoseOfNext => Reading::PoseOfPrevious.of(&repaired, i),
                Reading::PoseOfPrevious => Reading::PoseOfNext.of(&repaired, i),
                Reading::HalfSize => Reading::DoubleSize.of(&repaired, i),
                Reading::DoubleSize => Reading::HalfSize.of(&repaired, i),
                // The others undo themselves.
                other => other.of(&repaired, i),
            }
        };
        Some((0..truth.len()).map(undone).collect())
    }

    #[test]
    fn each_misreading_is_repaired_by_its_reading_alone() {
        let truth = path(14);
        let pairs = sightings(&truth);
        for reading in Reading::ALL {
            let wrong = misread(&truth, reading).unwrap();
            let scores: Vec<ReadingScore> = Reading::ALL.map(|r| score(r, &wrong, &pairs)).to_vec();
            let best = scores.iter().filter(|s| s.in_front.is_none_or(|share| share > 0.5));
            let best =
                best.min_by(|a, b| a.median.unwrap_or(1e9).total_cmp(&b.median.unwrap_or(1e9))).unwrap();
            assert_eq!(best.reading, reading, "{scores:?}");
            assert!(best.median.unwrap() < 1e-6 && best.in_front == Some(1.0), "{best:?}");
            for other in scores.iter().filter(|s| s.reading != reading) {
                let behind = other.in_front.is_some_and(|share| share < 0.5);
                assert!(behind || other.median.is_none_or(|m| m > 0.5), "{reading:?}: {other:?}");
            }
        }
    }

    proptest! {
        /// Against the definition of the focal length: pictures taken with `factor` times the focal length
        /// that is stated.
        #[test]
        fn a_wrong_focal_length_is_measured(factor in 0.6f64..1.7) {
            let truth = path(10);
            let pairs = sightings(&truth);
            let stated: Vec<Option<Posed>> = truth
                .iter()
                .map(|posed| {
                    let mut posed = *posed;
                    posed.intrinsics.fx /= factor;
                    posed.intrinsics.fy /= factor;
                    Some(posed)
                })
                .collect();
            let [found, _] = best_focal_factor(&stated, &pairs).unwrap();
            prop_assert!((found / factor - 1.0).abs() < 0.05, "{} {}", found, factor);
        }
    }

    #[test]
    fn quantiles_of_little_and_nothing() {
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(quantile(&[3.0], 0.9), Some(3.0));
        assert_eq!(median(vec![5.0, 1.0, 2.0]), Some(2.0));
        let nothing = score(Reading::AsRead, &[], &[]);
        assert_eq!((nothing.median, nothing.p90, nothing.in_front), (None, None, None));
    }
}
