//! The Pareto front of the points, and its knees.

use serde::Serialize;

/// Positions of the points `(cost, quality)` that no other is at least as good as at no greater cost, and better in one of the two;
/// in order of cost. Points with a number that is not finite are on no front.
#[must_use]
pub fn pareto_front(points: &[(f64, f64)]) -> Vec<usize> {
    let is_finite = |&i: &usize| points[i].0.is_finite() && points[i].1.is_finite();
    let mut order: Vec<usize> = (0..points.len()).filter(is_finite).collect();
    // Of equal cost the best first.
    order.sort_by(|&a, &b| {
        points[a].0.total_cmp(&points[b].0).then(points[b].1.total_cmp(&points[a].1)).then(a.cmp(&b))
    });
    let mut front: Vec<usize> = Vec::new();
    for i in order {
        let beaten =
            front.last().is_some_and(|&last| points[i].1 <= points[last].1 && points[i] != points[last]);
        if !beaten {
            front.push(i);
        }
    }
    front
}

/// Where a front bends: what the point costs against the best, and what it saves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Knee {
    /// Name of the point.
    pub point: String,
    /// Name of the point with the best quality.
    pub best: String,
    /// PSNR that the best has more, dB.
    pub decibels: f64,
    /// Cost that is saved against the best, in the unit of the cost.
    pub saved: f64,
    /// The same as a share of the best's cost.
    pub share: f64,
}

/// Position of the knee in a front `(cost, quality)` of ascending cost: the point farthest above the straight line from its first to
/// its last point, quality over the logarithm of the cost. None where nothing lies above that line.
#[must_use]
pub(super) fn knee(front: &[(f64, f64)]) -> Option<usize> {
    let (first, last) = (front.first()?, front.last()?);
    let width = last.0.ln() - first.0.ln();
    let height = last.1 - first.1;
    let above =
        |&(cost, quality): &(f64, f64)| (quality - first.1) / height - (cost.ln() - first.0.ln()) / width;
    let inner = front.iter().enumerate().map(|(i, point)| (i, above(point)));
    let best = inner.filter(|(_, above)| *above > 1e-9).max_by(|a, b| a.1.total_cmp(&b.1));
    best.map(|(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute_force(points: &[(f64, f64)]) -> Vec<usize> {
        let beats = |a: (f64, f64), b: (f64, f64)| a.0 <= b.0 && a.1 >= b.1 && a != b;
        let finite = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let on_front = |i: &usize| {
            finite(&points[*i]) && !points.iter().any(|&other| finite(&other) && beats(other, points[*i]))
        };
        (0..points.len()).filter(on_front).collect()
    }

    /// Few values, so that ties are frequent; now and then no number.
    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![9 => (-3..4i32).prop_map(f64::from), 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
    }

    proptest! {
        #[test]
        fn the_front_is_what_comparing_all_pairs_finds(
            points in prop::collection::vec((number(), number()), 0..24)
        ) {
            let front = pareto_front(&points);
            let mut sorted = front.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, brute_force(&points));
            prop_assert!(front.windows(2).all(|pair| points[pair[0]].0 <= points[pair[1]].0));
        }
    }

    #[test]
    fn the_knee_is_where_the_curve_turns() {
        let front = [(1.0, 10.0), (10.0, 19.0), (100.0, 19.5), (1000.0, 20.0)];
        assert_eq!(knee(&front), Some(1));
        assert_eq!(knee(&[(1.0, 10.0), (10.0, 15.0), (100.0, 20.0)]), None);
        assert_eq!(knee(&front[..2]), None);
        assert_eq!(knee(&[(1.0, 2.0), (1.0, 2.0)]), None);
        assert_eq!(knee(&[]), None);
    }
}
