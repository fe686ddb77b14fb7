use super::*;
use glam::{DMat3, DVec3};
use gs_scene::{LOG_SCALE, MEAN, QUATERNION, logit};
use proptest::prelude::*;

/// One Gaussian: mean, quaternion, logarithms of the scales, opacity, colour.
type Row = ([f32; 3], [f32; 4], [f32; 3], f32, [f32; 3]);

fn row() -> impl Strategy<Value = Row> {
    let quaternion = prop::array::uniform4(-1.0f32..1.0)
        .prop_filter("a rotation", |q| q.iter().map(|v| v * v).sum::<f32>() > 0.01);
    let scales = prop::array::uniform3(-4.0f32..0.0);
    (
        prop::array::uniform3(-2.0f32..2.0),
        quaternion,
        scales,
        0.02f32..0.98,
        prop::array::uniform3(-1.0f32..1.0),
    )
}

fn set(rows: &[Row]) -> Gaussians {
    let mut gaussians = Gaussians::empty(0).unwrap();
    for &(mean, quaternion, scales, opacity, sh) in rows {
        gaussians.push(mean, quaternion, scales, logit(opacity), &sh);
    }
    gaussians
}

fn widths(n: usize) -> Vec<f32> {
    (0..n).map(|i| 0.1 + 0.01 * (i % 7) as f32).collect()
}

/// Total optical mass, mass times mean, mass times second moments about the origin, mass times SH.
fn moments(clusters: &[Cluster], sh: &[f32], left: &[u32]) -> (f64, DVec3, DMat3, DVec3) {
    let mut total = (0.0, DVec3::ZERO, DMat3::ZERO, DVec3::ZERO);
    for &i in left {
        let Cluster { mass, mean, covariance, .. } = clusters[i as usize];
        let square = DMat3::from_cols(mean * mean.x, mean * mean.y, mean * mean.z);
        let sh = &sh[i as usize * 3..][..3];
        total.0 += mass;
        total.1 += mass * mean;
        total.2 += (covariance + square) * mass;
        total.3 += mass * DVec3::new(sh[0].into(), sh[1].into(), sh[2].into());
    }
    total
}

fn rows_of(gaussians: &Gaussians) -> Vec<Vec<u32>> {
    let rows = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).zip(gaussians.sh().chunks_exact(3));
    let mut rows: Vec<Vec<u32>> =
        rows.map(|(row, sh)| row.iter().chain(sh).map(|v| v.to_bits()).collect()).collect();
    rows.sort();
    rows
}

proptest! {
    #[test]
    fn the_count_is_exact_and_total_moments_stay(
        rows in prop::collection::vec(row(), 1..80), count in 1usize..90,
    ) {
        let mut gaussians = set(&rows);
        let mut clusters: Vec<Cluster> = gaussians
            .geometry()
            .chunks_exact(Gaussians::GEOMETRY)
            .zip(widths(rows.len()))
            .map(|(row, width)| Cluster::new(row, width))
            .collect();
        let (_, sh) = gaussians.buffers_mut();
        let mut left: Vec<u32> = (0..rows.len() as u32).collect();
        let before = moments(&clusters, sh, &left);
        reduce(&mut clusters, sh, &mut left, count, 4.0).unwrap();
        prop_assert_eq!(left.len(), count.min(rows.len()));
        prop_assert!(left.is_sorted());
        prop_assert_eq!(left.iter().map(|&i| clusters[i as usize].members).sum::<u32>(), rows.len() as u32);
        let after = moments(&clusters, sh, &left);
        let close = |a: f64, b: f64, digits: f64| (a - b).abs() <= digits * before.0 * 10.0;
        prop_assert!(close(before.0, after.0, 1e-12));
        prop_assert!((0..3).all(|i| close(before.1[i], after.1[i], 1e-12)));
        prop_assert!((0..9).all(|i| close(before.2.col(i / 3)[i % 3], after.2.col(i / 3)[i % 3], 1e-12)));
        // SH are averaged in f32.
        prop_assert!((0..3).all(|i| close(before.3[i], after.3[i], 1e-6)));
    }

    #[test]
    fn the_order_of_the_set_does_not_matter(
        rows in prop::collection::vec(row(), 2..60), count in 1usize..60, turn in 0usize..60,
    ) {
        let turned: Vec<Row> = (0..rows.len()).map(|i| rows[(i + turn) % rows.len()]).rev().collect();
        let merged = |rows: &[Row]| merge(set(rows), &vec![0.1; rows.len()], count).unwrap();
        prop_assert_eq!(rows_of(&merged(&rows).gaussians), rows_of(&merged(&turned).gaussians));
    }

    #[test]
    fn what_is_left_can_be_drawn_and_the_rest_is_named(
        rows in prop::collection::vec(row(), 1..80), count in 1usize..90,
    ) {
        let merged = merge(set(&rows), &widths(rows.len()), count).unwrap();
        prop_assert_eq!(merged.gaussians.len() + merged.absorbed.len(), rows.len());
        prop_assert!(merged.absorbed.is_sorted_by(|a, b| a < b));
        for row in merged.gaussians.geometry().chunks_exact(Gaussians::GEOMETRY) {
            prop_assert!(row.iter().all(|v| v.is_finite()), "{:?}", row);
            prop_assert!(row[LOG_SCALE].iter().all(|v| v.exp() > 0.0));
            prop_assert!((0.0..=0.9901).contains(&sigmoid(row[OPACITY_LOGIT])));
        }
    }
}

#[test]
fn a_count_that_suffices_changes_no_bit() {
    let rows: Vec<Row> = (0..9)
        .map(|i| ([i as f32, 0.3, -1.0], [0.1, 0.2, 0.3, 0.4], [-1.0, -2.0, -3.0], 0.999, [0.1; 3]))
        .collect();
    for count in [9, 10, usize::MAX] {
        let merged = merge(set(&rows), &widths(9), count).unwrap();
        assert_eq!((merged.gaussians, merged.absorbed), (set(&rows), vec![]));
    }
    let none = merge(set(&[]), &[], 5).unwrap();
    assert!(none.gaussians.is_empty() && none.absorbed.is_empty());
}

#[test]
fn two_in_one_place_let_as_much_light_pass_as_both() {
    let row: Row = ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0], [-1.0, -2.0, -4.0], 0.6, [0.5, -0.5, 0.0]);
    let merged = merge(set(&[row, row]), &[0.1; 2], 1).unwrap().gaussians;
    let found = merged.geometry();
    assert_eq!(&found[MEAN], &row.0);
    let wider = 0.5 * cluster::SPREAD.ln() as f32;
    assert!(found[LOG_SCALE].iter().zip(row.2).all(|(a, b)| (a - b - wider).abs() < 1e-5), "{found:?}");
    assert!((sigmoid(found[OPACITY_LOGIT]) - 0.84).abs() < 1e-5);
    assert!(found[QUATERNION][0].abs() > 0.999_99);
    assert_eq!(merged.sh(), row.4);
}

#[test]
fn the_same_colour_is_merged_before_the_nearer_one() {
    let gaussian =
        |x: f32, grey: f32| -> Row { ([x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [-3.0; 3], 0.6, [grey; 3]) };
    let merged =
        merge(set(&[gaussian(0.0, 1.0), gaussian(0.1, -1.0), gaussian(0.22, -1.0)]), &[0.1; 3], 2).unwrap();
    assert_eq!(merged.absorbed, [2]);
    assert_eq!(merged.gaussians.sh(), [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]);
}

#[test]
fn what_cannot_be_seen_goes_first_and_no_more_than_there_are_too_many() {
    let gaussian = |i: usize, opacity: f32| -> Row {
        ([i as f32, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [-3.0; 3], opacity, [0.0; 3])
    };
    let rows =
        [gaussian(0, 0.5), gaussian(1, 0.002), gaussian(2, 0.001), gaussian(3, 0.003), gaussian(4, 0.5)];
    for (count, absorbed) in [(4, vec![2]), (3, vec![1, 2]), (2, vec![1, 2, 3])] {
        let merged = merge(set(&rows), &[1.0; 5], count).unwrap();
        assert_eq!(merged.absorbed, absorbed, "{count}");
        let kept = rows_of(&merged.gaussians);
        assert!(kept.iter().all(|row| rows_of(&set(&rows)).contains(row)), "dropped, not merged");
    }
}

#[test]
fn duplicates_giants_and_specks_have_defined_results() {
    let gaussian = |mean: f32, scale: f32, opacity: f32| -> Row {
        ([mean; 3], [1.0, 0.0, 0.0, 0.0], [scale; 3], opacity, [0.0; 3])
    };
    let mut rows = vec![gaussian(0.5, -2.0, 0.6); 100];
    rows.extend([
        gaussian(1e6, 12.0, 0.9),
        gaussian(-1e6, -60.0, 0.9),
        gaussian(0.0, -40.0, 1e-6),
        gaussian(0.0, 20.0, 1.0 - 1e-6),
    ]);
    for count in [1, 2, 3, 50, 103] {
        let merged = merge(set(&rows), &widths(104), count).unwrap().gaussians;
        assert_eq!(merged.len(), count);
        let values = merged.geometry().iter().chain(merged.sh());
        assert!(values.clone().all(|v| v.is_finite()), "{count}: {:?}", merged.geometry());
    }
}
