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
/// Number of points that make half of a view's content.
pub(crate) const HALF: u8 = (POINTS / 2) as u8;
/// Squared cosine of the largest angle between two rays to a point under which photographs of it still match: 25
/// degrees. Tried on four sets of photographs: at 30 the chosen views match badly (fox is 1.3 dB lower, on targets that
/// differ with the choice), at 20 they leave over a third of its frames uncovered.
const MIN_COS2: f32 = 0.8214;

/// Thousandths; a distance of 0 is the same view, 1 shares nothing or is one median depth away, 3 is the largest.
const DISTANCE_UNIT: f64 = 1000.0;

/// What every view sees of every other one.
pub struct Overlaps {
    count: usize,
    /// `[viewer, viewed]`: how many of the viewed one's [`POINTS`] points the viewer sees.
    seen: Vec<u8>,
    /// `[viewer, viewed]`, in units of 1 / [`DISTANCE_UNIT`].
    distances: Vec<u16>,
}

impl Overlaps {
    /// Points that stand for a view's content.
    pub const POINTS: usize = POINTS;
    /// Number of points that make half of a view's content.
    pub const HALF: u8 = HALF;

    /// Counts for all pairs, in parallel over the viewers. Depths that are not positive and increasing give counts without a meaning.
    #[must_use]
    pub fn new(cameras: &[Camera], depth: SceneDepth) -> Self {
        let contents: Vec<Content> = cameras.iter().map(|camera| Content::new(camera, depth)).collect();
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
    #[must_use]
    pub fn seen_by(&self, viewer: usize) -> &[u8] {
        &self.seen[viewer * self.count..(viewer + 1) * self.count]
    }

    /// For each view, how far it is from the view `viewer`: the share of its points that `viewer` does not see plus
    /// the distance of the centres in median depths, up to 2.
    pub(crate) fn distances(&self, viewer: usize) -> &[u16] {
        &self.distances[viewer * self.count..(viewer + 1) * self.count]
    }
}

/// Share of a view's content that a viewer sees, 0..1. `depth` has been checked.
pub(crate) fn shared(viewed: &Camera, viewer: &Camera, depth: SceneDepth) -> f64 {
    f64::from(Content::new(viewed, depth).seen_by(viewer)) / POINTS as f64
}

/// Pixels at which a view's content is sampled.
const RAYS: usize = GRID * GRID;

/// What a view shows: the directions of its grid pixels, at three depths each. Single precision and one array per
/// axis, so that the compiler makes SIMD of the loops; lengths in median depths, so that no scale overflows.
struct Content {
    /// Scene units.
    position: DVec3,
    /// World directions of unit z-depth: x, y, z.
    rays: [[f32; RAYS]; 3],
    /// Their squared length.
    length2: [f32; RAYS],
    depths: [f32; DEPTHS],
    /// Scene units.
    median: f64,
}

impl Content {
    fn new(camera: &Camera, depth: SceneDepth) -> Self {
        let between = |a: f64, b: f64| 2.0 / (1.0 / a + 1.0 / b);
        let SceneDepth { near, median, far } = depth;
        let to_world = camera.rotation().transpose();
        let (mut rays, mut length2) = ([[0.0; RAYS]; 3], [0.0; RAYS]);
        for i in 0..RAYS {
            let cell = DVec2::new((i % GRID) as f64 + 0.5, (i / GRID) as f64 + 0.5) / GRID as f64;
            let pixel = cell * DVec2::new(camera.width() as f64, camera.height() as f64);
            let ray = to_world * camera.intrinsics().ray(pixel);
            (0..3).for_each(|axis| rays[axis][i] = ray[axis] as f32);
            length2[i] = ray.length_squared() as f32;
        }
        let depths =
            [between(near, median), median, between(median, far)].map(|depth| (depth / median) as f32);
        Self { position: camera.position(), rays, length2, depths, median }
    }

    /// How many of the points a viewer sees. Comparisons are multiplied out: no division, no root.
    fn seen_by(&self, viewer: &Camera) -> u8 {
        let lens = viewer.intrinsics();
        let rotation = viewer.rotation();
        // The difference of positions first: far from the origin their digits cancel.
        let offset = (rotation * (self.position - viewer.position()) / self.median).as_vec3();
        let rotation = rotation.as_mat3();
        let [fx, fy, cx, cy] = [lens.fx, lens.fy, lens.cx, lens.cy].map(|v| v as f32);
        let (width, height) = (lens.width as f32, lens.height as f32);
        let [dx, dy, dz]: [[f32; RAYS]; 3] = std::array::from_fn(|axis| {
            let row = rotation.row(axis);
            std::array::from_fn(|i| {
                row.x * self.rays[0][i] + row.y * self.rays[1][i] + row.z * self.rays[2][i]
            })
        });
        let mut seen = 0;
        for depth in self.depths {
            for (((dx, dy), dz), ray_length2) in dx.iter().zip(&dy).zip(&dz).zip(&self.length2) {
                let (x, y, z) = (dx * depth + offset.x, dy * depth + offset.y, dz * depth + offset.z);
                let (u, v) = (fx * x + cx * z, fy * y + cy * z);
                let inside = (z > 0.0) & (u >= 0.0) & (v >= 0.0) & (u <= width * z) & (v <= height * z);
                let along = dx * x + dy * y + dz * z;
                let length2 = ray_length2 * (x * x + y * y + z * z);
                let same_side = (along > 0.0) & (along * along >= MIN_COS2 * length2);
                seen += u32::from(inside & same_side);
            }
        }
        seen as u8
    }
}
