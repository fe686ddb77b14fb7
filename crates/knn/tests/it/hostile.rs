use crate::sets::set;
use knn::{Tree, brute_force, brute_force_query, knn, query};

#[test]
fn bad_coordinates_are_named_by_their_index() {
    let bad = [[0.0; 3], [1.0, f32::NAN, 0.0], [f32::INFINITY, 0.0, 0.0]];
    let text = "point 1 is (1, NaN, 0), expected finite coordinates: drop or mend it first";
    assert_eq!(knn(&bad, 1).unwrap_err().to_string(), text);
    assert_eq!(brute_force(&bad, 1).unwrap_err().to_string(), text);
    assert_eq!(query(&bad, &[[0.0; 3]], 1).unwrap_err().to_string(), text);
    assert_eq!(brute_force_query(&bad, &[[0.0; 3]], 1).unwrap_err().to_string(), text);
    let asked = query(&bad[..1], &bad[2..], 1).unwrap_err().to_string();
    assert_eq!(asked, "query 0 is (inf, 0, 0), expected finite coordinates: drop or mend it first");
    let asked = brute_force_query(&bad[..1], &bad[1..], 1).unwrap_err().to_string();
    assert_eq!(asked, "query 0 is (1, NaN, 0), expected finite coordinates: drop or mend it first");
    assert!(knn(&bad, 0).is_err(), "bad input is an error whatever k is");
    assert_eq!(Tree::new(&bad).map(|_| ()).unwrap_err().to_string(), text);
    let asked = Tree::new(&bad[..1]).unwrap().query(&bad[2..], 1).unwrap_err().to_string();
    assert_eq!(asked, "query 0 is (inf, 0, 0), expected finite coordinates: drop or mend it first");
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
    let degenerate = [
        "all-equal",
        "duplicates",
        "lattice",
        "signed-zeros",
        "overflow",
        "denormal",
        "mixed-scale",
        "collinear",
    ];
    for (shape, (n, k)) in
        degenerate.into_iter().flat_map(|shape| [(shape, (60_000, 8)), (shape, (10_000, 300))])
    {
        let points = set(shape, n, 5);
        let rows = [0, n / 2, n - 1];
        // One more than eight of all, so that eight others are among them.
        let slow = brute_force_query(&points, &rows.map(|row| points[row]), 9).unwrap();
        let found = knn(&points, k).unwrap();
        for (i, row) in rows.into_iter().enumerate() {
            let others: Vec<u32> = slow.row(i).0.iter().copied().filter(|&i| i as usize != row).collect();
            assert_eq!(found.row(row).0[..8], others[..8], "{shape}, row {row}");
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
