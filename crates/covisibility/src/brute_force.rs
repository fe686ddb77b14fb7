use crate::error::check;
use crate::neighbors::sq_distance;
use crate::{Anchors, Neighbors, Result, Settings};
use glam::DVec3;
use gs_scene::Camera;

/// [`crate::neighbors`] by comparing every anchor with every other, without a grid or threads: the definition that the
/// fast path is tested against. O(n²).
///
/// # Errors
/// As [`crate::neighbors`].
pub fn brute_force(anchors: &Anchors, cameras: &[Camera], settings: &Settings) -> Result<Neighbors> {
    check(anchors, cameras, settings)?;
    let mut found = Neighbors { starts: vec![0], indices: Vec::new(), sq_distances: Vec::new() };
    for (i, &position) in anchors.positions.iter().enumerate() {
        let mut row = Vec::new();
        for (view, camera) in cameras.iter().enumerate() {
            let position = DVec3::from(position);
            match camera.project(position) {
                Some(pixel) if view != anchors.views[i] as usize && camera.contains(pixel) => {
                    let depth = camera.to_camera(position).z;
                    in_view(anchors, view, camera, pixel.to_array(), depth, settings, &mut row);
                }
                _ => {}
            }
        }
        row.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        row.truncate(settings.k);
        found.indices.extend(row.iter().map(|&(_, index)| index));
        found.sq_distances.extend(row.iter().map(|&(sq_distance, _)| sq_distance));
        found.starts.push(found.indices.len());
    }
    Ok(found)
}

/// The candidates of one view, for an anchor that it sees at `pixel` in `depth`.
fn in_view(
    anchors: &Anchors,
    view: usize,
    camera: &Camera,
    pixel: [f64; 2],
    depth: f64,
    settings: &Settings,
    row: &mut Vec<(f32, u32)>,
) {
    for (j, &of) in anchors.views.iter().enumerate() {
        let place = anchors.pixels[j] as usize;
        let (x, y) = (place % camera.width(), place / camera.width());
        let sq_distance = sq_distance(pixel, x as f64, y as f64);
        if of as usize == view
            && sq_distance <= settings.radius * settings.radius
            && depth <= (1.0 + settings.tolerance) * f64::from(anchors.depths[j])
        {
            row.push((sq_distance as f32, j as u32));
        }
    }
}
