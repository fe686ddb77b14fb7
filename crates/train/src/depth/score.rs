//! How good depth is.

use serde::Serialize;

/// Depth of some views compared with the exact one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DepthScore {
    /// Mean absolute relative error of depth.
    pub relative: f64,
    /// Median absolute relative error of depth.
    pub median: f64,
    /// Share of the pixels within 2 %.
    pub within_2: f64,
    /// Share of the pixels within 5 %.
    pub within_5: f64,
    /// Share of the pixels beside an edge of the exact surface that are within 5 %.
    pub edges_within_5: f64,
    /// Share of the pixels with a confidence of ½ or more …
    pub confident: f64,
    /// … and of these, within 5 %.
    pub confident_within_5: f64,
    /// Area under the sparsification curve less that of an oracle, relative error.
    pub sparsification: f64,
}

/// Where the exact inverse depth of neighbouring pixels differs by this share there is an edge.
const EDGE: f32 = 0.05;
/// Pixels from an edge that are beside it.
const BESIDE: usize = 3;
/// Points of the sparsification curve.
const POINTS: usize = 20;

/// Collects pixels.
#[derive(Default)]
pub(crate) struct Collected {
    /// Relative error, confidence, whether it is beside an edge.
    pixels: Vec<(f32, f32, bool)>,
}

impl Collected {
    /// A view: exact depth (0 where there is no surface, NaN where it is not known), found depth and confidence, `[height, width]`. What is not
    /// known has no edge and does not count.
    pub(crate) fn add(&mut self, exact: &[f32], found: &[f32], confidence: &[f32], width: usize) {
        let height = exact.len() / width;
        let near =
            |v: f32, other: f32| v.is_nan() || other.is_nan() || (v - other).abs() <= EDGE * v.min(other);
        let mut edge = vec![false; exact.len()];
        for i in 0..exact.len() {
            let (x, y) = (i % width, i / width);
            let right = x + 1 < width && !near(exact[i], exact[i + 1]);
            let below = y + 1 < height && !near(exact[i], exact[i + width]);
            edge[i] = right || below;
        }
        let beside = |i: usize| {
            let (x, y) = (i % width, i / width);
            let rows = y.saturating_sub(BESIDE)..(y + BESIDE + 1).min(height);
            rows.into_iter().any(|v| {
                edge[v * width + x.saturating_sub(BESIDE)..v * width + (x + BESIDE + 1).min(width)]
                    .contains(&true)
            })
        };
        for i in 0..exact.len() {
            if exact[i] > 0.0 {
                self.pixels.push(((found[i] - exact[i]).abs() / exact[i], confidence[i], beside(i)));
            }
        }
    }

    pub(crate) fn score(mut self) -> DepthScore {
        let all = self.pixels.len().max(1) as f64;
        let share = |keep: &dyn Fn(&(f32, f32, bool)) -> bool, group: &dyn Fn(&(f32, f32, bool)) -> bool| {
            let members: Vec<_> = self.pixels.iter().filter(|pixel| group(pixel)).collect();
            members.iter().filter(|pixel| keep(pixel)).count() as f64 / members.len().max(1) as f64
        };
        let any = |_: &(f32, f32, bool)| true;
        let mut score = DepthScore {
            relative: self.pixels.iter().map(|p| f64::from(p.0)).sum::<f64>() / all,
            median: 0.0,
            within_2: share(&|p| p.0 <= 0.02, &any),
            within_5: share(&|p| p.0 <= 0.05, &any),
            edges_within_5: share(&|p| p.0 <= 0.05, &|p| p.2),
            confident: share(&|p| p.1 >= 0.5, &any),
            confident_within_5: share(&|p| p.0 <= 0.05, &|p| p.1 >= 0.5),
            sparsification: 0.0,
        };
        // Mean error of what is left when the least confident, or the worst, pixels go.
        let area = |sorted: &[(f32, f32, bool)]| {
            let mut sums = vec![0.0];
            for pixel in sorted {
                sums.push(sums[sums.len() - 1] + f64::from(pixel.0));
            }
            let left = |point: usize| (sorted.len() * (POINTS - point) / POINTS).max(1).min(sorted.len());
            (0..POINTS).map(|point| sums[left(point)] / left(point).max(1) as f64).sum::<f64>()
                / POINTS as f64
        };
        self.pixels.sort_by(|a, b| b.1.total_cmp(&a.1));
        let by_confidence = area(&self.pixels);
        self.pixels.sort_by(|a, b| a.0.total_cmp(&b.0));
        score.median = self.pixels.get(self.pixels.len() / 2).map_or(0.0, |p| f64::from(p.0));
        score.sparsification = by_confidence - area(&self.pixels);
        score
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_confidence_that_ranks_as_the_error_does_has_no_sparsification_error() {
        let exact: Vec<f32> = (0..100).map(|i| 2.0 + (i % 10 / 5) as f32).collect();
        let found: Vec<f32> = exact.iter().enumerate().map(|(i, z)| z * (1.0 + 0.001 * i as f32)).collect();
        let collected = |confidence: &dyn Fn(usize) -> f32| {
            let mut all = Collected::default();
            let confidence: Vec<f32> = (0..100).map(confidence).collect();
            all.add(&exact, &found, &confidence, 10);
            all.score()
        };
        let best = collected(&|i| 1.0 - 0.01 * i as f32);
        let worst = collected(&|i| 0.01 * i as f32);
        assert!(best.sparsification.abs() < 1e-9 && worst.sparsification > 0.02, "{best:?} {worst:?}");
        assert!((best.relative - 0.0495).abs() < 1e-4 && (best.median - 0.05).abs() < 2e-3, "{best:?}");
        assert!((best.within_2 - 0.2).abs() < 0.02 && (best.within_5 - 0.5).abs() < 0.02, "{best:?}");
        assert!((best.confident - 0.51).abs() < 0.02 && best.confident_within_5 > 0.97, "{best:?}");
    }

    #[test]
    fn no_pixels_and_pixels_without_a_surface_are_defined() {
        assert_eq!(Collected::default().score().relative, 0.0);
        let mut all = Collected::default();
        all.add(&[0.0, 1.0], &[3.0, 1.1], &[1.0, 0.0], 2);
        let score = all.score();
        assert!((score.relative - 0.1).abs() < 1e-6 && score.confident == 0.0);
        assert_eq!((score.edges_within_5, score.within_5), (0.0, 0.0), "beside nothing there is an edge");
        let mut all = Collected::default();
        all.add(&[f32::NAN, 1.0], &[3.0, 1.01], &[1.0, 0.0], 2);
        let score = all.score();
        assert!(
            (score.within_2, score.edges_within_5) == (1.0, 0.0),
            "beside what is not known there is none"
        );
    }
}
