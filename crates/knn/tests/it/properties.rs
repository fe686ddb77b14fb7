use crate::sets::{SHAPES, set};
use knn::{Neighbors, brute_force, knn, query};
use proptest::prelude::*;

/// Bits, so that a wrong sign of zero would show too.
fn bits(neighbors: &Neighbors) -> (usize, usize, &[u32], Vec<u32>) {
    let distances = neighbors.sq_distances.iter().map(|d| d.to_bits()).collect();
    (neighbors.rows, neighbors.k, &neighbors.indices, distances)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    #[test]
    fn knn_equals_brute_force(shape in prop::sample::select(&SHAPES[..]), n in 0..400usize, k in 0..40usize, seed: u64) {
        let points = set(shape, n, seed);
        let (fast, slow) = (knn(&points, k).unwrap(), brute_force(&points, k).unwrap());
        prop_assert_eq!(bits(&fast), bits(&slow));
    }

    #[test]
    fn query_equals_sorting_all_points(
        shape in prop::sample::select(&SHAPES[..]), asked in prop::sample::select(&SHAPES[..]),
        n in 0..300usize, n_queries in 0..60usize, k in 0..40usize, seed: u64,
    ) {
        let (points, queries) = (set(shape, n, seed), set(asked, n_queries, seed ^ 1));
        let found = query(&points, &queries, k).unwrap();
        prop_assert_eq!((found.rows, found.k), (n_queries, k.min(n)));
        for (row, q) in queries.iter().enumerate() {
            let mut all: Vec<(f32, u32)> = points.iter().zip(0..).map(|(p, i)| {
                let (dx, dy, dz) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
                (dx * dx + dy * dy + dz * dz, i)
            }).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            all.truncate(found.k);
            let (indices, sq_distances) = found.row(row);
            let found: Vec<(f32, u32)> = sq_distances.iter().copied().zip(indices.iter().copied()).collect();
            prop_assert_eq!(found, all);
        }
    }
}

#[test]
fn larger_sets_of_every_shape_equal_brute_force() {
    for shape in SHAPES {
        let points = set(shape, 2000, 7);
        let (fast, slow) = (knn(&points, 20).unwrap(), brute_force(&points, 20).unwrap());
        assert!(bits(&fast) == bits(&slow), "{shape}");
    }
}

#[test]
fn threads_do_not_change_the_result() {
    let points = set("clustered", 20_000, 3);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| knn(&points, 20).unwrap())
    };
    assert_eq!(bits(&on(1)), bits(&on(2)));
    assert_eq!(bits(&on(1)), bits(&on(5)));
}
