use crate::sets::set;
use knn::{brute_force, knn, query};

#[test]
fn bad_coordinates_are_named_by_their_index() {
    let bad = [[0.0; 3], [1.0, f32::NAN, 0.0], [f32::INFINITY, 0.0, 0.0]];
    let text = "point 1 is (1, NaN, 0), expected finite coordinates: drop or mend it first";
    assert_eq!(knn(&bad, 1).unwrap_err().to_string(), text);
    assert_eq!(brute_force(&bad, 1).unwrap_err().to_string(), text);
    assert_eq!(query(&bad, &[[0.0; 3]], 1).unwrap_err().to_string(), text);
    let asked = query(&bad[..1], &bad[2..], 1).unwrap_err().to_string();
    assert_eq!(asked, "query 0 is (inf, 0, 0), expected finite coordinates: drop or mend it first");
    assert!(knn(&bad, 0).is_err(), "bad input is an error whatever k is");
}

#[test]
fn what_does_not_exist_is_left_out() {
    let two = [[0.0; 3], [3.0, 0.0, 4.0]];
    let all = knn(&two, 20).unwrap();
    assert_eq!((all.rows, all.k), (2, 1));
    assert_eq!(all.row(1), (&[0u32][..], &[25.0f32][..]));
    let none: &[[f32; 3]] = &[];
    for (empty, rows) in [
        (knn(none, 3), 0),
        (knn(&two[..1], 3), 1),
        (knn(&two, 0), 2),
        (query(none, &two, 3), 2),
        (query(&two, none, 3), 0),
        (query(&two, &two, 0), 2),
    ] {
        let empty = empty.unwrap();
        assert_eq!(empty.rows, rows);
        assert!(empty.indices.is_empty() && empty.sq_distances.is_empty());
        if rows > 0 {
            assert_eq!(empty.row(rows - 1), (&[][..], &[][..]));
        }
    }
    assert_eq!(query(&two, &two, 20).unwrap().k, 2);
}

#[test]
fn distances_that_overflow_tie_by_index() {
    let far = [[3e38, 0.0, 0.0], [-3e38, 0.0, 0.0], [0.0, 3e38, 0.0], [0.0, -3e38, 0.0]];
    let found = knn(&far, 2).unwrap();
    assert_eq!(found.row(3), (&[0u32, 1][..], &[f32::INFINITY; 2][..]));
}

#[test]
fn the_smallest_differences_are_told_apart() {
    let step = f32::MIN_POSITIVE.sqrt();
    let points: Vec<[f32; 3]> = [0.0, 3.0, 1.0, 2.5].map(|t| [0.0, t * step, 0.0]).to_vec();
    let found = knn(&points, 3).unwrap();
    assert_eq!(found.row(0).0, [2, 3, 1]);
    assert!(found.row(0).1.iter().all(|&d| d > 0.0));
}

/// Without pruning by index among ties these would take minutes.
#[test]
fn large_degenerate_sets_take_no_quadratic_time() {
    for shape in ["all-equal", "duplicates", "lattice", "signed-zeros", "overflow"] {
        let points = set(shape, 60_000, 5);
        let found = knn(&points, 8).unwrap();
        for row in [0, 30_000, 59_999] {
            let q = points[row];
            let mut all: Vec<(f32, u32)> = (points.iter().zip(0..))
                .filter(|&(_, i)| i as usize != row)
                .map(|(p, i)| {
                    let (dx, dy, dz) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
                    (dx * dx + dy * dy + dz * dz, i)
                })
                .collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let expected: Vec<u32> = all[..8].iter().map(|&(_, i)| i).collect();
            assert_eq!(found.row(row).0, expected, "{shape}, row {row}");
        }
    }
}

#[test]
fn k_may_be_the_whole_set() {
    for shape in ["uniform", "lattice"] {
        let points = set(shape, 800, 11);
        assert_eq!(knn(&points, 5000), brute_force(&points, 5000));
    }
}
