//! How much of a view's content another view sees.

use crate::SceneDepth;
use glam::{DVec2, DVec3};
use gs_scene::Camera;
use rayon::prelude::*;

/// Pixels per image side on which content is sampled.
const GRID: usize = 6;
const DEPTHS: usize = 3;
/// Points that stand for a view's content.
pub(crate) const POINTS: usize = GRID * GRID * DEPTHS;
/// Squared cosine of the largest angle between two rays to a point under which photographs of it still match: 30
/// degrees, about where feature tracks break off.
const MIN_COS2: f64 = 0.75;

/// Thousandths; a distance of 0 is the same view, 1 shares nothing or is one median depth away, 3 is the largest.
const DISTANCE_UNIT: f64 = 1000.0;

/// What every view sees of every other one.
pub(crate) struct Overlaps {
    count: usize,
    /// `[viewer, viewed]`: how many of the viewed one's [`POINTS`] points the viewer sees.
    seen: Vec<u8>,
    /// `[viewer, viewed]`, in units of 1 / [`DISTANCE_UNIT`].
    distances: Vec<u16>,
}

impl Overlaps {
    /// Counts for all pairs, in parallel over the viewers. `depth` has been checked.
    pub(crate) fn new(cameras: &[Camera], depth: SceneDepth) -> Self {
        let between = |a: f64, b: f64| 2.0 / (1.0 / a + 1.0 / b);
        let depths = [between(depth.near, depth.median), depth.median, between(depth.median, depth.far)];
        let contents: Vec<Content> = cameras.iter().map(|camera| Content::new(camera, depths)).collect();
        let contents = &contents;
        let rows = cameras.par_iter().flat_map_iter(|viewer| {
            let position = viewer.position();
            contents.iter().map(move |content| {
                let seen = content.seen_by(viewer);
                let unseen = 1.0 - f64::from(seen) / POINTS as f64;
                let apart = (content.position.distance(position) / depth.median).min(2.0);
                (seen, ((unseen + apart) * DISTANCE_UNIT) as u16)
            })
        });
        let (seen, distances) = rows.unzip();
        Self { count: cameras.len(), seen, distances }
    }

    /// Number of views.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// For each view, how many of its points the view `viewer` sees.
    pub(crate) fn seen_by(&self, viewer: usize) -> &[u8] {
        &self.seen[viewer * self.count..(viewer + 1) * self.count]
    }

    /// For each view, how far it is from the view `viewer`: the share of its points that `viewer` does not see plus
    /// the distance of the centres in median depths, up to 2.
    pub(crate) fn distances(&self, viewer: usize) -> &[u16] {
        &self.distances[viewer * self.count..(viewer + 1) * self.count]
    }
}

/// What a view shows: the directions of its grid pixels, at three depths each.
struct Content {
    position: DVec3,
    /// World directions of unit z-depth, with their squared length.
    rays: [(DVec3, f64); GRID * GRID],
    depths: [f64; DEPTHS],
}

impl Content {
    fn new(camera: &Camera, depths: [f64; DEPTHS]) -> Self {
        let to_world = camera.rotation().transpose();
        let rays = std::array::from_fn(|i| {
            let cell = DVec2::new((i % GRID) as f64 + 0.5, (i / GRID) as f64 + 0.5) / GRID as f64;
            let pixel = cell * DVec2::new(camera.width() as f64, camera.height() as f64);
            let ray = to_world * camera.intrinsics().ray(pixel);
            (ray, ray.length_squared())
        });
        Self { position: camera.position(), rays, depths }
    }

    /// How many of the points a viewer sees. Comparisons are multiplied out: no division, no root.
    fn seen_by(&self, viewer: &Camera) -> u8 {
        let lens = viewer.intrinsics();
        let (width, height) = (lens.width as f64, lens.height as f64);
        let rotation = viewer.rotation();
        // The difference of positions first: far from the origin their digits cancel.
        let offset = rotation * (self.position - viewer.position());
        let mut seen = 0;
        for &(ray, ray_length2) in &self.rays {
            let direction = rotation * ray;
            for depth in self.depths {
                let point = direction * depth + offset;
                let (u, v) = (lens.fx * point.x + lens.cx * point.z, lens.fy * point.y + lens.cy * point.z);
                let inside = (point.z > 0.0)
                    & (u >= 0.0)
                    & (v >= 0.0)
                    & (u <= width * point.z)
                    & (v <= height * point.z);
                let along = direction.dot(point);
                let same_side =
                    (along > 0.0) & (along * along >= MIN_COS2 * ray_length2 * point.length_squared());
                seen += u8::from(inside & same_side);
            }
        }
        seen
    }
}
