//! Whether rows can be told apart: differences scene by scene, on the same windows.

use serde::Serialize;
use std::collections::BTreeMap;

/// A window's held-out PSNR, dB, by the name of the window.
pub(super) type ByWindow = BTreeMap<String, f64>;

/// A row against the reference, in dB of held-out PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Difference {
    /// Mean over scenes, of the mean over a scene's windows and the training seeds.
    pub(super) mean: f64,
    /// Half the 95 % interval of the mean by a paired t-test over scenes; none of a single scene.
    pub(super) interval: Option<f64>,
    /// The mean by training seed.
    pub(super) by_seed: Vec<f64>,
    /// How many scenes.
    pub(super) scene_count: usize,
    pub(super) verdict: Verdict,
}

/// What a difference says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    /// The interval excludes zero, and the difference has the same sign with every training seed.
    Better,
    Worse,
    /// Anything else.
    CannotBeTold,
}

/// What the verdict says of a difference of the paper.
pub(super) fn of_paper(verdict: Verdict, in_paper: Option<f64>) -> &'static str {
    match (verdict, in_paper) {
        (_, None) => "-",
        (Verdict::CannotBeTold, Some(_)) => "cannot be told",
        (Verdict::Better, Some(d)) if d > 0.0 => "confirmed",
        (Verdict::Worse, Some(d)) if d < 0.0 => "confirmed",
        (Verdict::Better | Verdict::Worse, Some(_)) => "contradicted",
    }
}

/// A row against a reference, each with one map for each training seed, in the same order. None if they share no window.
pub(super) fn difference(row: &[ByWindow], reference: &[ByWindow]) -> Option<Difference> {
    // By scene: windows of one scene are no independent samples.
    let mut by_scene: BTreeMap<&str, Vec<Vec<f64>>> = BTreeMap::new();
    for (seed, (row, reference)) in row.iter().zip(reference).enumerate() {
        for (window, psnr) in row {
            let Some(other) = reference.get(window) else { continue };
            let scene = window.rsplit_once('/').map_or(window.as_str(), |(scene, _)| scene);
            let seeds = by_scene.entry(scene).or_default();
            seeds.resize(seeds.len().max(seed + 1), Vec::new());
            seeds[seed].push(psnr - other);
        }
    }
    let seeds = by_scene.values().map(Vec::len).max()?;
    let mean_of = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let of_seed = |seed: usize| -> Option<f64> {
        let scenes: Vec<f64> =
            by_scene.values().filter_map(|seeds| seeds.get(seed).map(|windows| mean_of(windows))).collect();
        (!scenes.is_empty()).then(|| mean_of(&scenes))
    };
    let by_seed: Vec<f64> = (0..seeds).filter_map(of_seed).collect();
    let scenes: Vec<f64> = by_scene
        .values()
        .map(|seeds| mean_of(&seeds.iter().filter(|w| !w.is_empty()).map(|w| mean_of(w)).collect::<Vec<_>>()))
        .collect();
    let mean = mean_of(&scenes);
    let interval = half_interval(&scenes);
    let same_sign = by_seed.iter().all(|d| d.signum() == mean.signum());
    let verdict = match interval {
        Some(half) if same_sign && mean - half > 0.0 => Verdict::Better,
        Some(half) if same_sign && mean + half < 0.0 => Verdict::Worse,
        _ => Verdict::CannotBeTold,
    };
    Some(Difference { mean, interval, by_seed, scene_count: scenes.len(), verdict })
}

/// Half the 95 % interval of the mean of these by Student's t.
fn half_interval(values: &[f64]) -> Option<f64> {
    let n = values.len();
    if n < 2 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
    Some(quantile(n - 1) * (variance / n as f64).sqrt())
}

/// The 97.5 % quantile of Student's t with so many degrees of freedom (tables; above 30 the next lower row, which is wider).
fn quantile(degrees: usize) -> f64 {
    const TABLE: [f64; 30] = [
        12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145,
        2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048,
        2.045, 2.042,
    ];
    match degrees {
        0 => f64::INFINITY,
        1..=30 => TABLE[degrees - 1],
        31..60 => TABLE[29],
        60..120 => 2.000,
        _ => 1.980,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(values: &[(&str, f64)]) -> ByWindow {
        values.iter().map(|&(name, psnr)| (name.to_owned(), psnr)).collect()
    }

    #[test]
    fn a_difference_that_every_scene_and_seed_shows_is_told() {
        let reference = windows(&[("a/0", 20.0), ("a/1", 25.0), ("b/0", 30.0), ("c/0", 15.0)]);
        let row = windows(&[("a/0", 19.0), ("a/1", 24.2), ("b/0", 29.0), ("c/0", 14.1)]);
        let found = difference(&[row.clone(), row.clone()], &[reference.clone(), reference.clone()]).unwrap();
        // By hand: scenes -0.9, -1.0, -0.9; deviation 0.0577, over sqrt(3), times 4.303.
        assert!((found.mean + 0.9333).abs() < 1e-4 && found.scene_count == 3, "{found:?}");
        assert!((found.interval.unwrap() - 0.1434).abs() < 1e-4, "{found:?}");
        assert_eq!(found.verdict, Verdict::Worse);
        assert_eq!(of_paper(found.verdict, Some(-0.5)), "confirmed");
        assert_eq!(of_paper(found.verdict, Some(0.5)), "contradicted");
        assert_eq!(of_paper(found.verdict, None), "-");
        let other_way = difference(&[reference], &[row]).unwrap();
        assert_eq!(other_way.verdict, Verdict::Better);
    }

    #[test]
    fn what_scenes_or_seeds_contradict_is_not_told() {
        let reference = windows(&[("a/0", 20.0), ("b/0", 30.0)]);
        let mixed = windows(&[("a/0", 21.0), ("b/0", 29.5)]);
        assert_eq!(
            difference(&[mixed], std::slice::from_ref(&reference)).unwrap().verdict,
            Verdict::CannotBeTold
        );
        // Alike on every scene in the mean over seeds, but the seeds disagree.
        let (up, down) = (windows(&[("a/0", 21.0), ("b/0", 31.0)]), windows(&[("a/0", 19.5), ("b/0", 29.5)]));
        let found = difference(&[up, down], &[reference.clone(), reference.clone()]).unwrap();
        assert_eq!((found.verdict, found.by_seed.clone()), (Verdict::CannotBeTold, vec![1.0, -0.5]));
        assert_eq!(found.interval, Some(0.0));
        // One scene has no interval, and none in common no difference.
        let one = windows(&[("a/0", 25.0)]);
        let found = difference(&[one], std::slice::from_ref(&reference)).unwrap();
        assert_eq!((found.interval, found.verdict), (None, Verdict::CannotBeTold));
        assert_eq!(difference(&[windows(&[("z/0", 1.0)])], &[reference]), None);
        assert_eq!(difference(&[], &[]), None);
    }

    #[test]
    fn quantiles_fall_to_that_of_the_normal_distribution() {
        let all: Vec<f64> = (1..200).map(quantile).collect();
        assert!(all.windows(2).all(|pair| pair[0] >= pair[1]) && all[198] > 1.96);
    }
}
