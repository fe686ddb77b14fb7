//! The candidates within a distance of an anchor's projections that is likely to give k of them; if it does not, within more.

use crate::grid::{Grid, Grids, Window};
use crate::nearest::{Candidates, index, key, sq_distance};
use crate::neighbors::sq_distance as sq_distance_to_pixel;
use crate::{Anchors, Neighbors, Settings, parallel};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, Intrinsics};
use std::f64::consts::PI;

/// Anchors of a task.
const CHUNK: usize = 512;

/// Candidates that are looked for, for each that is wanted: fewer would often not be enough, more are sorted in vain.
const SPARE: f64 = 1.4;

/// By how much the area grows in which there were too few.
const GROWTH: f64 = 2.0;

/// Where a view sees an anchor of another.
struct Sight<'a> {
    grid: &'a Grid,
    /// Pixels.
    place: [f64; 2],
    /// z-depth in the view.
    depth: f64,
}

/// The rows of a task: where each ends, and their keys.
#[derive(Default)]
struct Rows {
    ends: Vec<usize>,
    keys: Vec<u64>,
}

struct Search<'a> {
    anchors: &'a Anchors<'a>,
    cameras: &'a [Camera],
    grids: Grids,
    k: usize,
    sq_radius: f64,
    /// An anchor's depth times this is how deep it lets others lie.
    slack: f64,
}

/// [`crate::neighbors`] of what was checked.
pub(crate) fn search(anchors: &Anchors, cameras: &[Camera], settings: &Settings) -> Neighbors {
    let n = anchors.positions.len();
    if settings.k == 0 {
        return Neighbors { starts: vec![0; n + 1], indices: Vec::new(), sq_distances: Vec::new() };
    }
    let search = Search {
        anchors,
        cameras,
        grids: Grids::new(anchors, cameras),
        k: settings.k,
        sq_radius: settings.radius * settings.radius,
        slack: 1.0 + settings.tolerance,
    };
    let state = || (Vec::new(), Candidates::default());
    let chunks = parallel::map(n.div_ceil(CHUNK), state, |(sights, candidates), chunk| {
        let mut rows = Rows::default();
        for i in chunk * CHUNK..n.min((chunk + 1) * CHUNK) {
            rows.keys.extend_from_slice(search.row(i, sights, candidates));
            rows.ends.push(rows.keys.len());
        }
        rows
    });
    joined(n, &chunks)
}

impl<'a> Search<'a> {
    /// The keys of one anchor's neighbours.
    fn row<'c>(&'a self, i: usize, sights: &mut Vec<Sight<'a>>, candidates: &'c mut Candidates) -> &'c [u64] {
        self.look(i, sights);
        let density: f64 = sights.iter().map(|sight| self.grids.density(sight.grid, sight.place)).sum();
        // Square pixels.
        let mut sq_reach = SPARE * self.k as f64 / (PI * density);
        loop {
            candidates.clear();
            let sees_all = self.collect(sights, sq_reach, candidates);
            if candidates.found() >= self.k || sq_reach >= self.sq_radius {
                return candidates.nearest(self.k);
            }
            sq_reach = if sees_all { f64::INFINITY } else { sq_reach * GROWTH };
        }
    }

    /// Where the other views see an anchor.
    fn look(&'a self, i: usize, sights: &mut Vec<Sight<'a>>) {
        sights.clear();
        let position = DVec3::from(self.anchors.positions[i]);
        for (view, (camera, grid)) in self.cameras.iter().zip(&self.grids.of).enumerate() {
            if view == self.anchors.views[i] as usize || grid.is_empty() {
                continue;
            }
            // `Camera::project`, with the depth that it divides by.
            let DVec3 { x, y, z: depth } = camera.to_camera(position);
            let &Intrinsics { fx, fy, cx, cy, .. } = camera.intrinsics();
            let pixel = DVec2::new(fx * x / depth + cx, fy * y / depth + cy);
            if depth > 0.0 && camera.contains(pixel) {
                sights.push(Sight { grid, place: pixel.to_array(), depth });
            }
        }
    }

    /// The candidates within a distance. Whether no anchor lies in cells farther away.
    fn collect(&self, sights: &[Sight], sq_reach: f64, candidates: &mut Candidates) -> bool {
        // Compared as rows are ordered, after rounding: no candidate that is left out is as near as one that is taken.
        let sq_reach = sq_reach.min(self.sq_radius) as f32;
        let reach = f64::from(sq_reach).sqrt() * (1.0 + 1e-6);
        let mut sees_all = true;
        for &Sight { grid, place, depth } in sights {
            let window = Grids::window(grid, place, reach);
            sees_all &= window.is_all(grid);
            let Window { columns, rows } = window;
            for row in rows {
                candidates.extend(self.grids.entries(grid, row, &columns), |entry| {
                    let exact = sq_distance_to_pixel(place, f64::from(entry.x), f64::from(entry.y));
                    let rounded = exact as f32;
                    let is_hidden = depth > self.slack * f64::from(entry.depth);
                    (
                        key(rounded, entry.index),
                        (rounded <= sq_reach) & (exact <= self.sq_radius) & !is_hidden,
                    )
                });
            }
        }
        sees_all
    }
}

/// The rows of all tasks.
fn joined(n: usize, chunks: &[Rows]) -> Neighbors {
    let mut starts = Vec::with_capacity(n + 1);
    starts.push(0);
    for rows in chunks {
        let first = starts[starts.len() - 1];
        starts.extend(rows.ends.iter().map(|end| first + end));
    }
    let total = starts[n];
    let (mut indices, mut sq_distances) = (vec![0; total], vec![0.0; total]);
    let mut tasks = Vec::with_capacity(chunks.len());
    let (mut indices_left, mut sq_distances_left) = (&mut indices[..], &mut sq_distances[..]);
    for rows in chunks {
        let (own_indices, other_indices) = indices_left.split_at_mut(rows.keys.len());
        let (own_distances, other_distances) = sq_distances_left.split_at_mut(rows.keys.len());
        tasks.push((&rows.keys, own_indices, own_distances));
        (indices_left, sq_distances_left) = (other_indices, other_distances);
    }
    parallel::for_each(tasks, |(keys, indices, sq_distances)| {
        for ((&key, to_index), to_distance) in keys.iter().zip(indices).zip(sq_distances) {
            (*to_index, *to_distance) = (index(key), sq_distance(key));
        }
    });
    Neighbors { starts, indices, sq_distances }
}
