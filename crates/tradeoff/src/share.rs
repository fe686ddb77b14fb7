//! The number of Gaussians at which a curve reaches a given quality.

use serde::Serialize;

/// Where a curve reaches a quality.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "reached", rename_all = "kebab-case")]
pub enum Reached {
    /// At so many Gaussians, between two that were measured.
    At {
        /// How many.
        gaussians: f64,
    },
    /// Already at the smallest count that was measured.
    AtOnce {
        /// That count.
        gaussians: f64,
    },
    /// Nowhere on the curve.
    Never,
}

/// Where a curve of `(Gaussians, quality)`, in any order, first reaches `quality`; between two points it is straight over the
/// logarithm of the count. Points that are not finite, or without Gaussians, are left out.
#[must_use]
pub fn reaches(curve: &[(f64, f64)], quality: f64) -> Reached {
    let usable = |&(n, q): &(f64, f64)| n > 0.0 && n.is_finite() && q.is_finite();
    let mut curve: Vec<(f64, f64)> = curve.iter().copied().filter(usable).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    match curve.first() {
        Some(&(gaussians, first)) if first >= quality => return Reached::AtOnce { gaussians },
        _ => {}
    }
    let crossing = curve.windows(2).find(|pair| pair[0].1 < quality && pair[1].1 >= quality);
    let Some([(n, q), (n_next, q_next)]) = crossing.and_then(|pair| <[_; 2]>::try_from(pair).ok()) else {
        return Reached::Never;
    };
    let t = (quality - q) / (q_next - q);
    Reached::At { gaussians: (n.ln() + t * (n_next.ln() - n.ln())).exp().clamp(n, n_next) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn count(reached: Reached) -> f64 {
        match reached {
            Reached::At { gaussians } | Reached::AtOnce { gaussians } => gaussians,
            Reached::Never => f64::INFINITY,
        }
    }

    #[test]
    fn between_two_points_the_logarithm_of_the_count_counts() {
        let curve = [(10_000.0, 22.0), (1_000.0, 20.0), (100_000.0, 22.5)];
        let Reached::At { gaussians } = reaches(&curve, 21.0) else { panic!() };
        assert!((gaussians - 1000.0 * 10f64.sqrt()).abs() < 1e-6, "{gaussians}");
        assert_eq!(reaches(&curve, 20.0), Reached::AtOnce { gaussians: 1000.0 });
        assert_eq!(reaches(&curve, 22.6), Reached::Never);
        assert_eq!(reaches(&[], 1.0), Reached::Never);
        assert_eq!(reaches(&[(5.0, f64::NAN), (0.0, 30.0)], 1.0), Reached::Never);
        assert_eq!(reaches(&curve, f64::NAN), Reached::Never);
    }

    proptest! {
        #[test]
        fn the_curve_has_the_quality_where_it_reaches_it(
            curve in prop::collection::vec((1.0..1e6f64, 10.0..30.0f64), 1..9),
            quality in 9.0..31.0f64,
        ) {
            let mut sorted = curve.clone();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            match reaches(&curve, quality) {
                Reached::Never => prop_assert!(curve.iter().all(|point| point.1 < quality)),
                Reached::AtOnce { gaussians } => prop_assert_eq!(gaussians, sorted[0].0),
                Reached::At { gaussians } => {
                    let next = sorted.partition_point(|point| point.0 < gaussians).clamp(1, sorted.len() - 1);
                    let ((n, q), (m, r)) = (sorted[next - 1], sorted[next]);
                    let there = q + (r - q) * (gaussians / n).ln() / (m / n).ln();
                    prop_assert!(n == m || (there - quality).abs() < 1e-6, "{} for {}", there, quality);
                }
            }
            prop_assert!(count(reaches(&curve, quality)) <= count(reaches(&curve, quality + 0.5)));
        }
    }
}
