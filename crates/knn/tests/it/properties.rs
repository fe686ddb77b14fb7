use crate::sets::{SHAPES, set};
use knn::{Neighbors, Tree, brute_force, brute_force_query, knn, query};
use proptest::prelude::*;

/// Bits, so that a wrong sign of zero would show too.
fn bits(neighbors: &Neighbors) -> (usize, usize, &[u32], Vec<u32>) {
    let distances = neighbors.sq_distances.iter().map(|d| d.to_bits()).collect();
    (neighbors.rows, neighbors.k, &neighbors.indices, distances)
}

/// Around the sizes of leaves and runs, and anything between.
fn size(limit: usize) -> impl Strategy<Value = usize> {
    prop_oneof![2 => prop::sample::select(vec![0, 1, 2, 31, 32, 33, 64, 65]), 5 => 0..limit]
}

fn how_many() -> impl Strategy<Value = usize> {
    prop_oneof![2 => prop::sample::select(vec![0, 1, 20, 30, 31, 32, 33, 64, 65]), 4 => 0..40usize, 1 => 40..420usize]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn knn_equals_brute_force(
        shape in prop::sample::select(&SHAPES[..]), n in size(400), k in how_many(), seed: u64,
    ) {
        let points = set(shape, n, seed);
        let (fast, slow) = (knn(&points, k).unwrap(), brute_force(&points, k).unwrap());
        prop_assert_eq!(bits(&fast), bits(&slow));
    }

    #[test]
    fn query_equals_brute_force(
        shape in prop::sample::select(&SHAPES[..]), asked in prop::sample::select(&SHAPES[..]),
        n in size(300), n_queries in size(70), k in how_many(), seed: u64,
    ) {
        let (points, queries) = (set(shape, n, seed), set(asked, n_queries, seed ^ 1));
        let (fast, slow) = (query(&points, &queries, k).unwrap(), brute_force_query(&points, &queries, k).unwrap());
        prop_assert_eq!((fast.rows, fast.k), (n_queries, k.min(n)));
        prop_assert_eq!(bits(&fast), bits(&slow));
    }

    #[test]
    fn a_tree_answers_every_search_as_a_fresh_one(
        shape in prop::sample::select(&SHAPES[..]), n in size(300), n_queries in size(70), ks in prop::array::uniform3(how_many()), seed: u64,
    ) {
        let (points, queries) = (set(shape, n, seed), set(shape, n_queries, seed ^ 1));
        let tree = Tree::new(&points).unwrap();
        prop_assert_eq!((tree.len(), tree.is_empty()), (n, n == 0));
        for k in ks {
            let (again, fresh) = (tree.query(&queries, k).unwrap(), query(&points, &queries, k).unwrap());
            prop_assert_eq!(bits(&again), bits(&fresh));
            let (again, fresh) = (tree.knn(k), knn(&points, k).unwrap());
            prop_assert_eq!(bits(&again), bits(&fresh));
        }
    }
}

/// The two oracles differ by the point itself: what is left of all points without it are the others.
#[test]
fn the_oracles_agree() {
    for shape in SHAPES {
        let points = set(shape, 100, 3);
        let (others, all) =
            (brute_force(&points, 99).unwrap(), brute_force_query(&points, &points, 100).unwrap());
        for row in 0..100 {
            let (indices, sq_distances) = all.row(row);
            let without_itself: Vec<(u32, f32)> = (indices.iter().copied().zip(sq_distances.iter().copied()))
                .filter(|&(i, _)| i as usize != row)
                .collect();
            let (indices, sq_distances) = others.row(row);
            let expected: Vec<(u32, f32)> =
                indices.iter().copied().zip(sq_distances.iter().copied()).collect();
            assert_eq!(without_itself, expected, "{shape}, row {row}");
        }
    }
}

#[test]
fn larger_sets_of_every_shape_equal_brute_force() {
    for shape in SHAPES {
        let points = set(shape, 1200, 7);
        let slow = brute_force(&points, 300).unwrap();
        for k in [1, 5, 20, 30, 64, 300] {
            let fast = knn(&points, k).unwrap();
            for row in 0..points.len() {
                let ((indices, sq_distances), expected) = (fast.row(row), slow.row(row));
                assert_eq!(
                    (indices, sq_distances),
                    (&expected.0[..k], &expected.1[..k]),
                    "{shape}, k {k}, row {row}"
                );
            }
        }
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
    // Compared across features and processors, too: the same set has the same rows everywhere.
    let mut sum = 0xcbf2_9ce4_8422_2325u64;
    for word in bits(&on(2)).2.iter().chain(&bits(&on(2)).3) {
        sum = (sum ^ u64::from(*word)).wrapping_mul(0x100_0000_01b3);
    }
    assert_eq!(sum, 0xf5e9_9107_dbdb_3a06, "{sum:#x}");
}
