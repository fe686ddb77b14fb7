//! kiddo, set up as is fastest for whole point sets here.

use crate::failure::{OrFail, Outcome};
use anyhow::Context;
use kiddo::{Eytzinger, FlatVec, KdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::hint::black_box;
use std::num::NonZero;

/// Of the trees that it has the fastest to build, with the size of buckets that is fastest to search.
type Tree = KdTree<f32, u32, Eytzinger, FlatVec<f32, u32, 3, 64>, 3, 64>;

/// Builds the tree and searches the `k` nearest others of every point; `queries` are the points in the order that suits it.
pub(super) fn search(points: &[[f32; 3]], queries: &[[f32; 3]], k: usize) -> Outcome {
    // Its results hold the point itself.
    let with_itself = NonZero::<usize>::MIN.saturating_add(k);
    let tree = Tree::new_from_slice(points).ok().context("kiddo refuses the points").or_work()?;
    queries.par_iter().for_each(|query| {
        black_box(tree.query(query).nearest_n::<SquaredEuclidean<f32>>(with_itself).execute());
    });
    Ok(())
}

/// The points along a Morton curve of 1024 cells an axis: neighbouring queries visit the same nodes.
pub(super) fn in_spatial_order(points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points {
        low = std::array::from_fn(|a| low[a].min(point[a]));
        high = std::array::from_fn(|a| high[a].max(point[a]));
    }
    let mut sorted = points.to_vec();
    sorted.sort_by_cached_key(|point| {
        (0..3).fold(0u64, |code, a| {
            let cell = ((point[a] - low[a]) / (high[a] - low[a]) * 1023.0) as u64;
            (0..10).fold(code, |code, bit| code | (cell >> bit & 1) << (3 * bit + a))
        })
    });
    sorted
}

#[cfg(test)]
mod tests {
    use super::super::Case;
    use super::*;

    #[test]
    fn it_finds_what_knn_finds() {
        for case in [Case::Surfaces, Case::Uniform] {
            let points = case.points(500);
            let tree = Tree::new_from_slice(&points).unwrap();
            let ours = knn::knn(&points, 5).unwrap();
            for (i, point) in points.iter().enumerate() {
                let found =
                    tree.query(point).nearest_n::<SquaredEuclidean<f32>>(NonZero::new(6).unwrap()).execute();
                let distances: Vec<f32> = found.iter().skip(1).map(|item| item.distance).collect();
                // Sums in another order.
                for (ours, theirs) in ours.row(i).1.iter().zip(&distances) {
                    assert!((ours - theirs).abs() <= 1e-5 * ours, "{ours} {theirs}");
                }
            }
        }
    }

    #[test]
    fn order_changes_no_point() {
        let points = Case::Surfaces.points(300);
        let mut sorted = in_spatial_order(&points);
        assert_ne!(sorted, points);
        let by_value = |a: &[f32; 3], b: &[f32; 3]| a.partial_cmp(b).unwrap();
        let mut points = points;
        points.sort_by(by_value);
        sorted.sort_by(by_value);
        assert_eq!(sorted, points);
    }
}
