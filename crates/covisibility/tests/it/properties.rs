use crate::sets::{SHAPES, set};
use covisibility::{Neighbors, Settings, brute_force, neighbors};
use proptest::prelude::*;

/// Bits, so that a wrong sign of zero would show too.
fn bits(neighbors: &Neighbors) -> (&[usize], &[u32], Vec<u32>) {
    (&neighbors.starts, &neighbors.indices, neighbors.sq_distances.iter().map(|d| d.to_bits()).collect())
}

fn settings() -> impl Strategy<Value = Settings> {
    let k = prop_oneof![prop::sample::select(vec![0, 1, 20, 31, 32, 33, usize::MAX]), 0..50usize];
    let radius = prop_oneof![
        prop::sample::select(vec![0.0, 1e-200, 0.5, 1.0, 2.0f64.sqrt(), 5.0, 1e3, 1e300]),
        0.0..30.0f64
    ];
    let tolerance = prop_oneof![prop::sample::select(vec![0.0, 0.05, 1.0, f64::MAX]), 0.0..2.0f64];
    (k, radius, tolerance).prop_map(|(k, radius, tolerance)| Settings { k, radius, tolerance })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn neighbors_equal_brute_force(
        shape in prop::sample::select(&SHAPES[..]), n in 0..400usize, views in 1..7usize, settings in settings(), seed: u64,
    ) {
        let set = set(shape, n, views, seed);
        let fast = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
        let slow = brute_force(&set.anchors(), &set.cameras, &settings).unwrap();
        prop_assert_eq!(bits(&fast), bits(&slow));
        prop_assert_eq!(fast.rows(), n);
    }

    #[test]
    fn rows_keep_the_definition(
        shape in prop::sample::select(&SHAPES[..]), n in 0..200usize, views in 1..7usize, settings in settings(), seed: u64,
    ) {
        let set = set(shape, n, views, seed);
        let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
        for i in 0..n {
            let (indices, sq_distances) = found.row(i);
            prop_assert!(indices.len() <= settings.k);
            prop_assert!(indices.iter().all(|&j| set.views[j as usize] != set.views[i]));
            let order: Vec<_> = sq_distances.iter().zip(indices).collect();
            prop_assert!(order.is_sorted_by(|a, b| a < b), "{:?}", order);
        }
    }
}

#[test]
fn larger_sets_of_every_shape_equal_brute_force() {
    for shape in SHAPES {
        let set = set(shape, 3000, 6, 7);
        for (k, radius) in [(20, 8.0), (20, 1e3), (1, 3.0), (150, 30.0)] {
            let settings = Settings { k, radius, tolerance: 0.05 };
            let fast = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
            let slow = brute_force(&set.anchors(), &set.cameras, &settings).unwrap();
            assert!(bits(&fast) == bits(&slow), "{shape}, k {k}, radius {radius}");
        }
    }
}

#[test]
fn the_lattice_has_ties_and_the_sets_have_neighbours() {
    let settings = Settings { k: 20, radius: 8.0, tolerance: 0.05 };
    for shape in SHAPES {
        let set = set(shape, 1000, 6, 3);
        let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
        assert!(found.indices.len() > 500, "{shape}: {}", found.indices.len());
        if shape == "lattice" {
            let ties = (0..1000).filter(|&i| found.row(i).1.windows(2).any(|pair| pair[0] == pair[1]));
            assert!(ties.count() > 500);
        }
    }
}

#[test]
fn threads_do_not_change_the_result() {
    let set = set("arc", 5000, 6, 3);
    let settings = Settings { k: 20, radius: 6.0, tolerance: 0.05 };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| neighbors(&set.anchors(), &set.cameras, &settings).unwrap())
    };
    assert!(bits(&on(1)) == bits(&on(2)));
    assert!(bits(&on(1)) == bits(&on(5)));
}
