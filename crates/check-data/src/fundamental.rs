//! Matches that agree with one unknown epipolar geometry: RANSAC over eight matches at a time.

use super::epipolar::symmetric_distance;
use super::linear::{add_square, smallest_eigenvector};
use super::matching::Match;
use glam::{DMat3, DVec2};

/// Positions of the matches whose symmetric epipolar distance to the best fundamental matrix found is at most
/// `bound` pixels; `None` if too few agree on any. Deterministic in `seed`.
pub(crate) fn fundamental_inliers(matches: &[Match], bound: f64, seed: u64) -> Option<Vec<usize>> {
    if matches.len() < MIN_INLIERS {
        return None;
    }
    // Numbers near 1 keep the equations well conditioned.
    let (centre, scale) = frame_of(matches);
    let unit: Vec<Match> = matches
        .iter()
        .map(|m| Match { first: (m.first - centre) / scale, second: (m.second - centre) / scale })
        .collect();
    let bound = bound / scale;
    let agreeing = |matrix: &DMat3, bound: f64| -> Vec<usize> {
        (0..unit.len()).filter(|&i| symmetric_distance(matrix, &unit[i]) <= bound).collect()
    };
    let mut random = Random(seed);
    let mut best: Vec<usize> = Vec::new();
    let (mut tried, mut wanted) = (0, MAX_TRIALS);
    while tried < wanted {
        tried += 1;
        let sample = random.eight(unit.len());
        let Some(matrix) = fit(sample.iter().map(|&i| &unit[i])) else { continue };
        let found = agreeing(&matrix, bound);
        if found.len() <= best.len() {
            continue;
        }
        best = found;
        // Eight noisy matches make a poor matrix, which few others agree with; those near it make a better
        // one.
        let mut improved = matrix;
        for widened in REFITS {
            let near = agreeing(&improved, widened * bound);
            let Some(refitted) = fit(near.iter().map(|&i| &unit[i])) else { break };
            improved = refitted;
            let found = agreeing(&improved, bound);
            if found.len() > best.len() {
                best = found;
            }
        }
        wanted = trials(best.len() as f64 / unit.len() as f64);
    }
    let enough = best.len() >= MIN_INLIERS && best.len() as f64 >= MIN_SHARE * matches.len() as f64;
    enough.then_some(best)
}

/// Matches that agree, at least: by chance eight always do, and some more.
const MIN_INLIERS: usize = 20;
/// Share of the matches that agree, at least.
const MIN_SHARE: f64 = 0.3;
const MAX_TRIALS: usize = 1000;
/// Refits take in matches up to so many bounds.
const REFITS: [f64; 4] = [3.0, 2.0, 1.0, 1.0];

/// Trials after which a sample without outliers has been drawn with a probability of 99.9 %.
fn trials(share: f64) -> usize {
    // `ln_1p` keeps small shares; a share of 1 gives 0 trials. A cast of infinity saturates.
    let needed = 0.001f64.ln() / (-share.powi(8)).ln_1p();
    (needed.ceil() as usize).clamp(1, MAX_TRIALS)
}

fn frame_of(matches: &[Match]) -> (DVec2, f64) {
    let count = 2.0 * matches.len() as f64;
    let centre = matches.iter().map(|m| m.first + m.second).sum::<DVec2>() / count;
    let spread: f64 = matches.iter().map(|m| m.first.distance(centre) + m.second.distance(centre)).sum();
    (centre, (spread / count).max(f64::MIN_POSITIVE))
}

/// The matrix F of rank 2 with second' F first = 0 for all matches, in the least squares of the algebraic
/// error.
fn fit<'a>(matches: impl Iterator<Item = &'a Match>) -> Option<DMat3> {
    let mut normal = [[0.0; 9]; 9];
    for Match { first: a, second: b } in matches {
        let row = [b.x * a.x, b.x * a.y, b.x, b.y * a.x, b.y * a.y, b.y, a.x, a.y, 1.0];
        add_square(&mut normal, &row);
    }
    let full = DMat3::from_cols_array(&smallest_eigenvector(&normal)?).transpose();
    let square = (full.transpose() * full).to_cols_array_2d();
    let null = glam::DVec3::from_array(smallest_eigenvector(&square)?);
    let image = full * null;
    Some(full - DMat3::from_cols(image * null.x, image * null.y, image * null.z))
}

/// Draws of a counter-based generator (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut v = self.0;
        v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        v ^ (v >> 31)
    }

    /// Eight different numbers below `count`, which is at least [`MIN_INLIERS`].
    fn eight(&mut self, count: usize) -> [usize; 8] {
        let mut drawn = [usize::MAX; 8];
        for i in 0..8 {
            drawn[i] = loop {
                let candidate = (self.next() % count as u64) as usize;
                if !drawn[..i].contains(&candidate) {
                    break candidate;
                }
            };
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::epipolar::{Posed, fundamental};
    use glam::DVec3;
    use gs_scene::Intrinsics;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        /// Two cameras see points of a box; a third of the matches are elsewhere. Those that are kept are
        /// right.
        #[test]
        fn outliers_are_thrown_out(
            seed in any::<u64>(),
            turn in -0.3f64..0.3,
            tilt in -0.2f64..0.2,
            x in 0.3f64..1.0,
        ) {
            let lens = Intrinsics { fx: 300.0, fy: 310.0, cx: 160.0, cy: 120.0, width: 320, height: 240 };
            let first = Posed { intrinsics: lens, axes: DMat3::IDENTITY, position: DVec3::ZERO };
            let axes = DMat3::from_euler(glam::EulerRot::YXZ, turn, tilt, 0.1);
            let second = Posed { intrinsics: lens, axes, position: DVec3::new(x, 0.2, -0.1) };
            let mut random = Random(seed);
            let mut unit = || random.next() as f64 / u64::MAX as f64;
            let mut matches = Vec::new();
            for i in 0..150 {
                let point = DVec3::new(4.0 * unit() - 2.0, 3.0 * unit() - 1.5, 3.0 + 4.0 * unit());
                let mut found = Match { first: first.project(point), second: second.project(point) };
                let noise = DVec2::new(unit() - 0.5, unit() - 0.5) * 0.2;
                found.second += noise;
                if i % 3 == 0 {
                    found.second = DVec2::new(320.0 * unit(), 240.0 * unit());
                }
                matches.push(found);
            }
            let kept = fundamental_inliers(&matches, 1.0, seed ^ 77).expect("two thirds agree");
            let truth = fundamental(&first, &second);
            let wrong = kept.iter().filter(|&&i| symmetric_distance(&truth, &matches[i]) > 2.0).count();
            prop_assert!(kept.iter().filter(|&&i| i % 3 != 0).count() >= 90, "{}", kept.len());
            prop_assert!(wrong <= 4, "{wrong} of {}", kept.len());
        }
    }

    #[test]
    fn chance_and_degenerate_matches_do_not_agree_or_stay_finite() {
        let mut random = Random(5);
        let mut unit = || random.next() as f64 / u64::MAX as f64;
        let matches: Vec<Match> = (0..120)
            .map(|_| Match {
                first: DVec2::new(320.0 * unit(), 240.0 * unit()),
                second: DVec2::new(320.0 * unit(), 240.0 * unit()),
            })
            .collect();
        assert_eq!(fundamental_inliers(&matches, 1.0, 1), None);
        assert_eq!(fundamental_inliers(&matches[..10], 1.0, 1), None);
        // All in one point: nothing to fit, and nothing to hang on.
        let point = Match { first: DVec2::ONE, second: DVec2::ONE };
        let _ = fundamental_inliers(&[point; 40], 1.0, 1);
        // A picture against itself agrees with a whole family of matrices; all matches are right.
        let same: Vec<Match> = matches.iter().map(|m| Match { second: m.first, ..*m }).collect();
        assert_eq!(fundamental_inliers(&same, 1.0, 1).map(|kept| kept.len()), Some(120));
    }
}
