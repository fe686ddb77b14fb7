//! The places of the cameras, and which of them share content.

use super::report::{LayoutSummary, OverlapSummary};
use glam::DVec3;
use gs_scene::Camera;
use view_data::{Overlaps, SceneDepth};

/// Centres so many median distances away are outliers.
const OUTLIER: f64 = 10.0;
/// Overlap is counted for all pairs; more frames than this would take minutes.
pub(crate) const MAX_OVERLAP_FRAMES: usize = 4000;
/// Steps to the nearest camera are taken of so many frames at most.
const MAX_STEPS: usize = 1000;

/// The layout of the cameras; `names` belong to them.
pub(crate) fn find_layout(positions: &[DVec3], names: &[&str]) -> LayoutSummary {
    let middle = |axis: usize| super::readings::median(positions.iter().map(|p| p[axis]).collect());
    let [Some(x), Some(y), Some(z)] = [middle(0), middle(1), middle(2)] else {
        return LayoutSummary::default();
    };
    let centre = DVec3::new(x, y, z);
    let distances: Vec<f64> = positions.iter().map(|p| p.distance(centre)).collect();
    let spread = super::readings::median(distances.clone()).unwrap_or(0.0);
    let is_outlier = |distance: f64| spread > 0.0 && distance > OUTLIER * spread;
    let outliers = names.iter().zip(&distances).filter(|(_, distance)| is_outlier(**distance));
    let stride = positions.len().div_ceil(MAX_STEPS).max(1);
    let step = |i: usize| {
        let others = (0..positions.len()).filter(|&j| j != i);
        others.map(|j| positions[i].distance(positions[j])).reduce(f64::min)
    };
    let steps = (0..positions.len()).step_by(stride).filter_map(step).collect();
    LayoutSummary {
        centre: centre.to_array(),
        spread,
        reach: distances.iter().copied().fold(0.0, f64::max),
        step: super::readings::median(steps).unwrap_or(0.0),
        outliers: outliers.map(|(name, _)| (*name).to_owned()).collect(),
    }
}

/// Root mean square distance of the positions from their best line, over that from their mean; 0 on a line.
/// `None` if they are all in one place.
pub(crate) fn off_line(positions: &[DVec3]) -> Option<f64> {
    let mean = positions.iter().sum::<DVec3>() / positions.len().max(1) as f64;
    let mut square = [[0.0; 3]; 3];
    for position in positions {
        super::linear::add_square(&mut square, &(*position - mean).to_array());
    }
    let total: f64 = (0..3).map(|i| square[i][i]).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    // Largest eigenvalue by repeated squaring: (M / trace M)^64 leaves its vector alone.
    let mut power = glam::DMat3::from_cols_array_2d(&square) * total.recip();
    for _ in 0..6 {
        power = power * power;
        let trace = power.x_axis.x + power.y_axis.y + power.z_axis.z;
        power *= trace.recip();
    }
    let columns = [power.x_axis, power.y_axis, power.z_axis];
    let direction = columns.into_iter().fold(DVec3::ZERO, |a, b| if b.length() > a.length() { b } else { a });
    let direction = direction.try_normalize()?;
    let along = direction.dot(glam::DMat3::from_cols_array_2d(&square) * direction) / total;
    Some((1.0 - along).max(0.0).sqrt())
}

/// The overlap of all frames, with each one's share and group.
pub(crate) struct Overlap {
    pub(crate) summary: OverlapSummary,
    /// Per frame: the largest share of its content that one other frame sees.
    pub(crate) shared: Vec<f64>,
    /// Per frame: its group, 0 is the largest.
    pub(crate) component: Vec<usize>,
}

/// Who sees what of whom, by the depth of the scene. Two frames hang together if each sees at least half of
/// the other's content, the rule by which views are selected.
pub(crate) fn find_overlap(cameras: &[Camera], depth: SceneDepth) -> Overlap {
    let overlaps = Overlaps::new(cameras, depth);
    let count = cameras.len();
    let mut shared = vec![0.0f64; count];
    let mut edges = Vec::new();
    let mut partners = vec![0usize; count];
    for i in 0..count {
        let seen = overlaps.seen_by(i);
        for j in (0..count).filter(|&j| j != i) {
            shared[j] = shared[j].max(f64::from(seen[j]) / Overlaps::POINTS as f64);
            if i < j && seen[j] >= Overlaps::HALF && overlaps.seen_by(j)[i] >= Overlaps::HALF {
                edges.push([i, j]);
                partners[i] += 1;
                partners[j] += 1;
            }
        }
    }
    let (component, components) = groups(count, &edges);
    let partners = super::readings::median(partners.into_iter().map(|n| n as f64).collect()).unwrap_or(0.0);
    Overlap { summary: OverlapSummary { components, edges, partners }, shared, component }
}

/// The group of every node, the largest group first (of equal ones, the one with the lowest node), and their
/// sizes.
fn groups(count: usize, edges: &[[usize; 2]]) -> (Vec<usize>, Vec<usize>) {
    let mut parent: Vec<usize> = (0..count).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    for &[a, b] in edges {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b)] = a.min(b);
    }
    let roots: Vec<usize> = (0..count).map(|i| root(&mut parent, i)).collect();
    let mut sizes = vec![0usize; count];
    roots.iter().for_each(|&root| sizes[root] += 1);
    let mut order: Vec<usize> = (0..count).filter(|&i| sizes[i] > 0).collect();
    order.sort_by_key(|&root| (std::cmp::Reverse(sizes[root]), root));
    let mut rank = vec![0; count];
    order.iter().enumerate().for_each(|(position, &root)| rank[root] = position);
    let sizes = order.iter().map(|&root| sizes[root]).collect();
    (roots.into_iter().map(|root| rank[root]).collect(), sizes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_are_named_and_one_place_is_one_place() {
        let mut positions: Vec<DVec3> =
            (0..20).map(|i| DVec3::new(f64::from(i % 5), f64::from(i / 5), 0.0)).collect();
        positions[7] = DVec3::new(900.0, 0.0, 0.0);
        let names: Vec<String> = (0..20).map(|i| format!("f{i}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let layout = find_layout(&positions, &names);
        assert_eq!(layout.outliers, ["f7"]);
        assert!((layout.step - 1.0).abs() < 1e-9 && layout.reach > 800.0);
        let same = find_layout(&[DVec3::ONE; 4], &names[..4]);
        assert_eq!((same.spread, same.reach, same.outliers.len()), (0.0, 0.0, 0));
        assert_eq!(find_layout(&[], &[]), LayoutSummary::default());
    }

    #[test]
    fn lines_are_told_from_arcs() {
        let along = |i: i32| DVec3::new(1.0, 2.0, -0.5) * f64::from(i) + DVec3::splat(100.0);
        let line: Vec<DVec3> = (0..30).map(along).collect();
        assert!(off_line(&line).unwrap() < 1e-6);
        let arc = |i: i32| DVec3::new((f64::from(i) * 0.05).cos(), (f64::from(i) * 0.05).sin(), 0.0);
        assert!(off_line(&(0..30).map(arc).collect::<Vec<_>>()).unwrap() > 0.1);
        assert_eq!(off_line(&[DVec3::ONE; 3]), None);
        assert_eq!(off_line(&[]), None);
    }

    #[test]
    fn groups_are_sorted_by_size() {
        let (labels, sizes) = groups(7, &[[1, 2], [2, 3], [5, 6]]);
        assert_eq!(sizes, [3, 2, 1, 1]);
        assert_eq!(labels, [2, 0, 0, 0, 3, 1, 1]);
        assert_eq!(groups(0, &[]), (vec![], vec![]));
    }
}
