use crate::error::check;
use crate::{Neighbors, Result};

/// [`crate::knn`] by comparing every pair, without a tree, blocks or threads: the definition that the fast path is
/// tested against. O(n² log n).
///
/// # Errors
/// As [`crate::knn`].
pub fn brute_force(points: &[[f32; 3]], k: usize) -> Result<Neighbors> {
    check("point", points)?;
    let k = k.min(points.len().saturating_sub(1));
    Ok(by_sorting(points, points, k, true))
}

/// [`crate::query`] by comparing every query with every point, as [`brute_force`]. O(queries · n log n).
///
/// # Errors
/// As [`crate::query`].
pub fn brute_force_query(points: &[[f32; 3]], queries: &[[f32; 3]], k: usize) -> Result<Neighbors> {
    check("point", points)?;
    check("query", queries)?;
    Ok(by_sorting(points, queries, k.min(points.len()), false))
}

/// The first `k` of all points, or all but the `row`-th, in the order of distance and index.
fn by_sorting(points: &[[f32; 3]], queries: &[[f32; 3]], k: usize, others: bool) -> Neighbors {
    let (mut indices, mut sq_distances) = (Vec::new(), Vec::new());
    for (row, q) in queries.iter().enumerate() {
        let mut all: Vec<(f32, u32)> = Vec::with_capacity(points.len());
        for (index, p) in points.iter().enumerate() {
            if !(others && index == row) {
                let (dx, dy, dz) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
                all.push((dx * dx + dy * dy + dz * dz, index as u32));
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(sq_distance, index) in &all[..k] {
            indices.push(index);
            sq_distances.push(sq_distance);
        }
    }
    Neighbors { rows: queries.len(), k, indices, sq_distances }
}
