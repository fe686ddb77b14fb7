//! Whether rows can be told apart: differences scene by scene, on the same windows.

use scene_windows::scene_of;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

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

/// What a difference says of that of the paper. It confirms the paper's if its interval excludes zero on the paper's side. It contradicts the paper's if its
/// interval excludes zero otherwise, or holds zero and excludes the paper's. Else it cannot be told.
pub(super) fn of_paper(difference: &Difference, in_paper: Option<f64>) -> &'static str {
    let Some(in_paper) = in_paper else { return "-" };
    let is_excluded = difference.interval.is_some_and(|half| (difference.mean - in_paper).abs() > half);
    match difference.verdict {
        Verdict::CannotBeTold if is_excluded => "contradicted",
        Verdict::CannotBeTold => "cannot be told",
        Verdict::Better if in_paper > 0.0 => "confirmed",
        Verdict::Worse if in_paper < 0.0 => "confirmed",
        Verdict::Better | Verdict::Worse => "contradicted",
    }
}

/// Pairs of a row and its reference, by training seed.
pub(super) type Pairs<'a> = BTreeMap<u64, [&'a ByWindow; 2]>;

/// Rows against one reference, window by window. None of a row that shares no window with it.
///
/// The intervals are of scenes and training seeds that were not tried. The variance of a difference is that of scenes plus that of training seeds. That of
/// scenes is s²/n, with the deviation s of the means by scene (over seeds). That of seeds is taken to be the same for all rows, so that they are estimated
/// together: [`of_seeds`]. Degrees of freedom follow from Welch and Satterthwaite. Windows of one scene are no independent samples, nor are those of one
/// seed. Nothing is corrected for the number of rows.
pub(super) fn differences(rows: &[Pairs<'_>]) -> Vec<Option<Difference>> {
    let means: Vec<Option<Means>> = rows.iter().map(Means::of).collect();
    let of_seeds = of_seeds(means.iter().flatten().map(|means| &means.by_training_seed));
    let tell = |means: Means| {
        let mean = mean_of(means.by_scene.iter().copied());
        let interval = half_interval(&means, of_seeds);
        let verdict = match interval {
            Some(half) if mean - half > 0.0 => Verdict::Better,
            Some(half) if mean + half < 0.0 => Verdict::Worse,
            _ => Verdict::CannotBeTold,
        };
        let scene_count = means.by_scene.len();
        Difference { mean, interval, by_training_seed: means.by_training_seed, scene_count, verdict }
    };
    means.into_iter().map(|means| means.map(tell)).collect()
}

/// Means of a row's differences.
struct Means {
    /// Over seeds, per scene.
    by_scene: Vec<f64>,
    /// Over scenes.
    by_training_seed: BTreeMap<u64, f64>,
}

impl Means {
    fn of(row: &Pairs<'_>) -> Option<Self> {
        let mut by_scene: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        let mut by_training_seed = BTreeMap::new();
        for (&seed, [row, reference]) in row {
            let mut scenes: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
            for (window, psnr) in *row {
                if let Some(other) = reference.get(window) {
                    scenes.entry(scene_of(window)).or_default().push(psnr - other);
                }
            }
            let scenes: BTreeMap<&str, f64> =
                scenes.into_iter().map(|(scene, windows)| (scene, mean_of(windows))).collect();
            if !scenes.is_empty() {
                by_training_seed.insert(seed, mean_of(scenes.values().copied()));
            }
            scenes.into_iter().for_each(|(scene, mean)| by_scene.entry(scene).or_default().push(mean));
        }
        let by_scene: Vec<f64> = by_scene.into_values().map(mean_of).collect();
        (!by_scene.is_empty()).then_some(Self { by_scene, by_training_seed })
    }
}

fn mean_of(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, n) = values.into_iter().fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0));
    sum / n
}

/// A variance and its degrees of freedom.
type Estimate = (f64, f64);

/// The variance that a training seed gives a row, beyond what it gives all rows alike: that of the residuals of the table of rows and seeds without the
/// means of its rows and columns. The reference is a row of zeros in it. Of rows that have every seed; None if there is none, or one seed.
fn of_seeds<'a>(rows: impl Iterator<Item = &'a BTreeMap<u64, f64>> + Clone) -> Option<Estimate> {
    let seeds: BTreeSet<u64> = rows.clone().flat_map(|row| row.keys().copied()).collect();
    let seed_count = seeds.len();
    let rows = rows.filter(|row| row.len() == seed_count).map(|row| row.values().copied().collect());
    let table: Vec<Vec<f64>> = std::iter::once(vec![0.0; seed_count]).chain(rows).collect();
    let degrees = ((table.len() - 1) * seed_count.saturating_sub(1)) as f64;
    let of_seed: Vec<f64> = (0..seed_count).map(|seed| mean_of(table.iter().map(|row| row[seed]))).collect();
    let whole = mean_of(of_seed.iter().copied());
    let squares = table.iter().map(|row| {
        let of_row = mean_of(row.iter().copied());
        row.iter()
            .zip(&of_seed)
            .map(|(value, of_seed)| (value - of_row - of_seed + whole).powi(2))
            .sum::<f64>()
    });
    (degrees > 0.0).then(|| (squares.sum::<f64>() / degrees, degrees))
}

/// Half the 95 % interval of the mean of a row's differences; `of_seeds` is the variance of one row by training seeds.
fn half_interval(means: &Means, of_seeds: Option<Estimate>) -> Option<f64> {
    let (scenes, seed_count) = (&means.by_scene, means.by_training_seed.len());
    if scenes.len() < 2 || seed_count < 2 {
        return None;
    }
    let (n, mean) = (scenes.len() as f64, mean_of(scenes.iter().copied()));
    let of_scenes = scenes.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0) / n;
    // A difference is one of two rows.
    let (of_seeds, degrees) = of_seeds.map(|(one, degrees)| (2.0 * one / seed_count as f64, degrees))?;
    let variance = of_scenes + of_seeds;
    let spread = of_scenes * of_scenes / (n - 1.0) + of_seeds * of_seeds / degrees;
    let degrees = if spread > 0.0 {
        (variance * variance / spread * (1.0 + 1e-9)).floor() as usize
    } else {
        scenes.len() - 1
    };
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

    fn pairs<'a>(seeds: &[[&'a ByWindow; 2]]) -> Pairs<'a> {
        (7..).zip(seeds.iter().copied()).collect()
    }

    fn of(seeds: &[[&ByWindow; 2]]) -> Option<Difference> {
        differences(&[pairs(seeds)]).remove(0)
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
        assert_eq!(of_paper(&found, Some(-0.5)), "confirmed");
        assert_eq!(of_paper(&found, Some(0.5)), "contradicted");
        assert_eq!(of_paper(&found, None), "-");
        assert_eq!(of(&[[&reference, &row], [&reference, &other]]).unwrap().verdict, Verdict::Better);
    }

    #[test]
    fn rows_estimate_the_variance_of_training_seeds_together() {
        // Every scene alike, so that the seeds alone count: row 1 is 1.0 and 1.2 above the reference, row 2 -0.5 and -0.5.
        let scenes = |psnr: f64| windows(&[("a/0", psnr), ("b/0", psnr), ("c/0", psnr)]);
        let reference = scenes(20.0);
        let (up, more, down) = (scenes(21.0), scenes(21.2), scenes(19.5));
        let rows = [
            pairs(&[[&up, &reference], [&more, &reference]]),
            pairs(&[[&down, &reference], [&down, &reference]]),
        ];
        // By hand: the table is 0 0, 1.0 1.2, -0.5 -0.5. Its residuals are ±0.0333 (0.1 less two thirds of it), ∓0.0667 and ±0.0333 in the two columns:
        // squares 2 (0.00111 + 0.00444 + 0.00111) = 0.01333, over 2 degrees of freedom 0.00667. Two rows over two seeds: 0.00667.
        let half = 4.303 * (2.0_f64 * 0.006_667 / 2.0).sqrt();
        let found = differences(&rows);
        for (found, mean) in found.iter().zip([1.1, -0.5]) {
            let found = found.as_ref().unwrap();
            assert!((found.mean - mean).abs() < 1e-9, "{found:?}");
            assert!((found.interval.unwrap() - half).abs() < 1e-3, "{found:?}, {half}");
        }
        // A row with fewer seeds has no part in the estimate, and uses it.
        let middle = scenes(21.1);
        let rows = [
            pairs(&[[&up, &reference], [&more, &reference], [&middle, &reference]]),
            pairs(&[[&down, &reference]; 3]),
            pairs(&[[&up, &reference], [&more, &reference]]),
            pairs(&[[&up, &reference]]),
        ];
        // Residuals of the first row are two thirds of -0.1, 0.1 and 0, of the others a third: squares 0.02 · 6/9 over 4 degrees of freedom, 0.003333.
        let half = |seeds: f64| 2.776 * (2.0_f64 * 0.003_333 / seeds).sqrt();
        let found = differences(&rows);
        let interval = |row: usize| found[row].as_ref().unwrap().interval;
        for (row, seeds) in [(0, 3.0), (1, 3.0), (2, 2.0)] {
            assert!((interval(row).unwrap() - half(seeds)).abs() < 1e-3, "{row}: {found:?}");
        }
        assert_eq!(interval(3), None);
        // Seeds that only one of two rows has: neither has all.
        let [one, other] = [[7, 8], [7, 9]].map(|seeds| {
            seeds.into_iter().zip([[&up, &reference], [&more, &reference]]).collect::<Pairs<'_>>()
        });
        assert!(differences(&[one, other]).iter().flatten().all(|found| found.interval.is_none()));
    }

    #[test]
    fn what_scenes_or_seeds_contradict_or_one_alone_shows_is_not_told() {
        let reference = windows(&[("a/0", 20.0), ("b/0", 30.0)]);
        let mixed = windows(&[("a/0", 21.0), ("b/0", 29.5)]);
        let told = |seeds: &[[&ByWindow; 2]]| of(seeds).unwrap().verdict;
        assert_eq!(told(&[[&mixed, &reference], [&mixed, &reference]]), Verdict::CannotBeTold);
        let wide = of(&[[&mixed, &reference], [&mixed, &reference]]).unwrap();
        for (in_paper, expected) in
            [(0.5, "cannot be told"), (100.0, "contradicted"), (-100.0, "contradicted")]
        {
            assert_eq!(of_paper(&wide, Some(in_paper)), expected, "{wide:?}");
        }
        // No difference is none of the size that the paper has, which lies outside the interval.
        let same = of(&[[&mixed, &mixed], [&mixed, &mixed]]).unwrap();
        assert_eq!(
            (of_paper(&same, Some(-0.9)), of_paper(&same, Some(0.0))),
            ("contradicted", "cannot be told")
        );
        // Alike on every scene, but the seeds disagree.
        let (up, down) = (windows(&[("a/0", 21.0), ("b/0", 31.0)]), windows(&[("a/0", 19.5), ("b/0", 29.5)]));
        let found = of(&[[&up, &reference], [&down, &reference]]).unwrap();
        assert_eq!(found.verdict, Verdict::CannotBeTold);
        assert_eq!(found.by_training_seed, BTreeMap::from([(7, 1.0), (8, -0.5)]));
        // One seed or one scene has no interval, and none in common no difference.
        let one = of(&[[&up, &reference]]).unwrap();
        assert_eq!((one.interval, one.verdict), (None, Verdict::CannotBeTold));
        assert_eq!(of_paper(&one, Some(-0.9)), "cannot be told");
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
