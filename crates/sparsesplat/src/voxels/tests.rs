use super::*;
use proptest::prelude::*;

fn check_partition(groups: &[Vec<u32>], n: usize) {
    let mut all: Vec<u32> = groups.concat();
    all.sort_unstable();
    assert!(all.iter().copied().eq(0..n as u32), "every point in one group");
    assert!(groups.iter().all(|group| !group.is_empty() && group.is_sorted()));
}

proptest! {
    #[test]
    fn the_count_is_exact_or_one_per_point(
        points in prop::collection::vec(prop::array::uniform3(-5.0f64..5.0), 1..300), count in 1usize..320,
    ) {
        let groups = groups(&points, &vec![0.1; points.len()], count);
        prop_assert_eq!(groups.len(), count.min(points.len()));
        check_partition(&groups, points.len());
    }

    #[test]
    fn most_groups_are_voxels_of_one_size(
        points in prop::collection::vec(prop::array::uniform3(0.0f64..1.0), 500), count in 20usize..200,
    ) {
        let grid = Grid::around(&points);
        let size = grid.solve(&points, &[0.01; 500], count);
        let found = grid.count(&points, size);
        prop_assert!(found <= count && found + count / 4 >= count, "{} of {}", found, count);
    }
}

#[test]
fn duplicates_lines_and_extreme_extents_give_the_count() {
    let line = |scale: f64| -> Vec<[f64; 3]> { (0..100).map(|i| [scale * f64::from(i), 0.0, 0.0]).collect() };
    let mut far = line(1e-3);
    far.push([1e9, -1e9, 1e9]);
    for points in [vec![[1.0, 2.0, 3.0]; 101], line(1.0), line(1e-9), line(1e9), far, vec![[0.0; 3]]] {
        for count in [1, 2, 7, 64, 99, 1_000, usize::MAX] {
            let groups = groups(&points, &vec![1e-3; points.len()], count);
            assert_eq!(groups.len(), count.min(points.len()), "{:?}, {count}", points[0]);
            check_partition(&groups, points.len());
        }
    }
    assert!(groups(&[], &[], 3).is_empty());
}

#[test]
fn the_fullest_is_halved_across_its_length() {
    let points = [[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.1, 1.0, 0.0], [0.0, 2.0, 0.0]];
    let mut group = vec![0, 1, 2, 3];
    assert_eq!(halve(&mut group, &points), [1, 3]);
    assert_eq!(group, [0, 2]);
}
