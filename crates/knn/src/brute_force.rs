use crate::error::check;
use crate::{Neighbors, Result};

/// [`crate::knn`] by comparing every pair, without a tree, blocks or threads: the definition that the fast path is
/// tested against. O(n² log n).
///
/// # Errors
/// As [`crate::knn`].
pub fn brute_force(points: &[[f32; 3]], k: usize) -> Result<Neighbors> {
    check("point", points)?;
    let rows = points.len();
    let k = k.min(rows.saturating_sub(1));
    let (mut indices, mut sq_distances) = (Vec::new(), Vec::new());
    for (i, p) in points.iter().enumerate() {
        let mut others: Vec<(f32, u32)> = Vec::with_capacity(rows);
        for (j, q) in points.iter().enumerate() {
            if i != j {
                let (dx, dy, dz) = (q[0] - p[0], q[1] - p[1], q[2] - p[2]);
                others.push((dx * dx + dy * dy + dz * dz, j as u32));
            }
        }
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(sq_distance, index) in &others[..k] {
            indices.push(index);
            sq_distances.push(sq_distance);
        }
    }
    Ok(Neighbors { rows, k, indices, sq_distances })
}
