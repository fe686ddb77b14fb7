//! Whether rows can be told apart: differences scene by scene, on the same windows.

use scene_windows::scene_of;
use serde::Serialize;
use std::collections::BTreeMap;

/// A window's held-out PSNR, dB, by the name of the window.
pub(super) type ByWindow = BTreeMap<String, f64>;

/// A row against the reference, in dB of held-out PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Difference {
    /// Mean over training seeds and scenes, of the mean over a scene's windows.
    pub(super) mean: f64,
    /// Half the 95 % interval of the mean; none of a single scene or training seed, which say nothing of others.
    pub(super) interval: Option<f64>,
    /// The mean by training seed.
    pub(super) by_training_seed: BTreeMap<u64, f64>,
    /// How many scenes.
    pub(super) scene_count: usize,
    pub(super) verdict: Verdict,
}

/// What a difference says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Verdict {
    /// The interval excludes zero.
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

/// A row against a reference, window by window, by training seed. None if they share no window.
///
/// The interval is of scenes and training seeds that were not tried: with the deviations s of the means by scene (over seeds) and by seed (over scenes),
/// its variance is s²/n of the scenes plus s²/n of the seeds, and its degrees of freedom follow from Welch and Satterthwaite. Windows of one scene are
/// no independent samples, nor are those of one seed. Nothing is corrected for the number of rows.
pub(super) fn difference(rows: &BTreeMap<u64, [&ByWindow; 2]>) -> Option<Difference> {
    let mut by_scene: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut by_training_seed = BTreeMap::new();
    for (&seed, [row, reference]) in rows {
        let mut scenes: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (window, psnr) in *row {
            if let Some(other) = reference.get(window) {
                scenes.entry(scene_of(window)).or_default().push(psnr - other);
            }
        }
        let scenes: BTreeMap<&str, f64> =
            scenes.iter().map(|(scene, windows)| (*scene, mean_of(windows))).collect();
        if !scenes.is_empty() {
            by_training_seed.insert(seed, mean_of(&scenes.values().copied().collect::<Vec<_>>()));
        }
        scenes.into_iter().for_each(|(scene, mean)| by_scene.entry(scene).or_default().push(mean));
    }
    let of_scenes: Vec<f64> = by_scene.values().map(|seeds| mean_of(seeds)).collect();
    let of_seeds: Vec<f64> = by_training_seed.values().copied().collect();
    if of_scenes.is_empty() {
        return None;
    }
    let mean = mean_of(&of_scenes);
    let interval = half_interval(&of_scenes, &of_seeds);
    let verdict = match interval {
        Some(half) if mean - half > 0.0 => Verdict::Better,
        Some(half) if mean + half < 0.0 => Verdict::Worse,
        _ => Verdict::CannotBeTold,
    };
    Some(Difference { mean, interval, by_training_seed, scene_count: of_scenes.len(), verdict })
}

fn mean_of(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Half the 95 % interval of the mean from its means by scene and by seed.
fn half_interval(scenes: &[f64], seeds: &[f64]) -> Option<f64> {
    if scenes.len() < 2 || seeds.len() < 2 {
        return None;
    }
    // Variance of the mean of these.
    let part = |values: &[f64]| {
        let (n, mean) = (values.len() as f64, mean_of(values));
        values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) / n
    };
    let parts = [scenes, seeds].map(|values| (part(values), values.len() as f64 - 1.0));
    let variance: f64 = parts.iter().map(|(part, _)| part).sum();
    let spread: f64 = parts.iter().map(|(part, degrees)| part * part / degrees).sum();
    let degrees =
        if spread > 0.0 { (variance * variance / spread).floor() as usize } else { scenes.len() - 1 };
    Some(quantile(degrees.max(1)) * variance.sqrt())
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

    fn of(seeds: &[[&ByWindow; 2]]) -> Option<Difference> {
        difference(&(7..).zip(seeds.iter().copied()).collect())
    }

    #[test]
    fn a_difference_that_every_scene_and_seed_shows_is_told() {
        let reference = windows(&[("a/0", 20.0), ("a/1", 25.0), ("b/0", 30.0), ("c/0", 15.0)]);
        let row = windows(&[("a/0", 19.0), ("a/1", 24.2), ("b/0", 29.0), ("c/0", 14.1)]);
        let other = windows(&[("a/0", 19.1), ("a/1", 24.3), ("b/0", 29.1), ("c/0", 14.2)]);
        let found = of(&[[&row, &reference], [&other, &reference]]).unwrap();
        // By hand: scenes -0.85, -0.95, -0.85 (variance 0.003333, over 3), seeds -0.9333, -0.8333 (0.005, over 2); variance of the mean 0.003611,
        // degrees of freedom 0.003611² / (0.001111² / 2 + 0.0025² / 1) = 1.9, so 1.
        assert!((found.mean + 0.8833).abs() < 1e-4 && found.scene_count == 3, "{found:?}");
        assert!((found.interval.unwrap() - 12.706 * 0.003_611_f64.sqrt()).abs() < 1e-3, "{found:?}");
        assert_eq!(found.by_training_seed.keys().copied().collect::<Vec<_>>(), [7, 8]);
        assert_eq!(found.verdict, Verdict::Worse);
        assert_eq!(of_paper(found.verdict, Some(-0.5)), "confirmed");
        assert_eq!(of_paper(found.verdict, Some(0.5)), "contradicted");
        assert_eq!(of_paper(found.verdict, None), "-");
        assert_eq!(of(&[[&reference, &row], [&reference, &other]]).unwrap().verdict, Verdict::Better);
    }

    #[test]
    fn what_scenes_or_seeds_contradict_or_one_alone_shows_is_not_told() {
        let reference = windows(&[("a/0", 20.0), ("b/0", 30.0)]);
        let mixed = windows(&[("a/0", 21.0), ("b/0", 29.5)]);
        let told = |seeds: &[[&ByWindow; 2]]| of(seeds).unwrap().verdict;
        assert_eq!(told(&[[&mixed, &reference], [&mixed, &reference]]), Verdict::CannotBeTold);
        // Alike on every scene, but the seeds disagree.
        let (up, down) = (windows(&[("a/0", 21.0), ("b/0", 31.0)]), windows(&[("a/0", 19.5), ("b/0", 29.5)]));
        let found = of(&[[&up, &reference], [&down, &reference]]).unwrap();
        assert_eq!(found.verdict, Verdict::CannotBeTold);
        assert_eq!(found.by_training_seed, BTreeMap::from([(7, 1.0), (8, -0.5)]));
        // One seed or one scene has no interval, and none in common no difference.
        let one = of(&[[&up, &reference]]).unwrap();
        assert_eq!((one.interval, one.verdict), (None, Verdict::CannotBeTold));
        let short = windows(&[("a/0", 25.0)]);
        assert_eq!(of(&[[&short, &reference], [&short, &reference]]).unwrap().interval, None);
        let elsewhere = windows(&[("z/0", 1.0)]);
        assert_eq!(of(&[[&elsewhere, &reference]]), None);
        assert_eq!(of(&[]), None);
        // A seed without a window in common says nothing, and is no NaN.
        let found = of(&[[&elsewhere, &reference], [&up, &reference], [&up, &reference]]).unwrap();
        assert_eq!((found.mean, found.by_training_seed.len(), found.interval), (1.0, 2, Some(0.0)));
    }

    #[test]
    fn quantiles_fall_to_that_of_the_normal_distribution() {
        let all: Vec<f64> = (1..200).map(quantile).collect();
        assert!(all.windows(2).all(|pair| pair[0] >= pair[1]) && all[198] > 1.96);
    }
}
