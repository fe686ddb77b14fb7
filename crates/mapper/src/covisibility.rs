//! What two views have in common.

use glam::{DVec2, DVec3};
use gs_scene::Camera;
use rayon::prelude::*;

/// Cells of the grid on which a view's content is sampled.
pub(crate) const COLUMNS: usize = 24;
pub(crate) const ROWS: usize = 16;
/// Points of a footprint.
pub(crate) const POINTS: usize = COLUMNS * ROWS;
/// A point that two views see at depths that differ by more than this, relative, is hidden from one of them.
const SAME_DEPTH: f64 = 0.1;
/// Seen from farther away than this factor, a surface shows less detail than it will need.
const SIMILAR_DISTANCE: f64 = 1.6;
/// Cosine of the largest angle under which two views of a point count as similar: 40 degrees.
const SIMILAR_DIRECTION: f64 = 0.766;

/// What a view shows: z-depth at the centres of the cells of a grid, 0 where it is not known.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Footprint {
    pub(crate) camera: Camera,
    pub(crate) depths: Vec<f32>,
}

/// Pixel position of a cell's centre.
fn cell(camera: &Camera, i: usize) -> DVec2 {
    let place = DVec2::new((i % COLUMNS) as f64 + 0.5, (i / COLUMNS) as f64 + 0.5);
    place * DVec2::new(camera.width() as f64 / COLUMNS as f64, camera.height() as f64 / ROWS as f64)
}

/// Values of a map `[height, width]` at the centres of the cells.
pub(crate) fn at_cells(width: usize, height: usize, values: &[f32]) -> impl Iterator<Item = f32> + '_ {
    (0..POINTS).map(move |i| {
        let x = (2 * (i % COLUMNS) + 1) * width / (2 * COLUMNS);
        let y = (2 * (i / COLUMNS) + 1) * height / (2 * ROWS);
        values[y.min(height - 1) * width + x.min(width - 1)]
    })
}

impl Footprint {
    /// Of a view with a depth map `[height, width]` of its size.
    pub(crate) fn new(camera: &Camera, depth: &[f32]) -> Self {
        Self { camera: *camera, depths: at_cells(camera.width(), camera.height(), depth).collect() }
    }

    /// The known points, in the world.
    pub(crate) fn points(&self) -> impl Iterator<Item = DVec3> + '_ {
        let known = self.depths.iter().enumerate().filter(|&(_, &depth)| depth > 0.0);
        known.map(|(i, &depth)| self.camera.unproject(cell(&self.camera, i), f64::from(depth)))
    }

    /// Median of the known depths; none if there are none.
    pub(crate) fn median(&self) -> Option<f64> {
        let mut known: Vec<f32> = self.depths.iter().copied().filter(|&depth| depth > 0.0).collect();
        let middle = known.len() / 2;
        (!known.is_empty()).then(|| f64::from(*known.select_nth_unstable_by(middle, f32::total_cmp).1))
    }

    /// The same with `depth` where it is not known.
    pub(crate) fn filled(mut self, depth: f64) -> Self {
        self.depths.iter_mut().filter(|known| **known <= 0.0).for_each(|known| *known = depth as f32);
        self
    }

    /// Share of the known points that lie in the picture of another camera, 0..1.
    pub(crate) fn share_in(&self, other: &Camera) -> f64 {
        let (mut inside, mut all) = (0_usize, 0_usize);
        for point in self.points() {
            all += 1;
            inside += usize::from(other.project(point).is_some_and(|pixel| other.contains(pixel)));
        }
        inside as f64 / all.max(1) as f64
    }

    /// Whether this view saw a point, at the depth at which it is, from a distance and a direction similar to those of `camera`.
    fn saw(&self, point: DVec3, camera: &Camera) -> bool {
        let Some(pixel) = self.camera.project(point).filter(|&pixel| self.camera.contains(pixel)) else {
            return false;
        };
        let column = (pixel.x / self.camera.width() as f64 * COLUMNS as f64) as usize;
        let row = (pixel.y / self.camera.height() as f64 * ROWS as f64) as usize;
        let there = f64::from(self.depths[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)]);
        let z = self.camera.to_camera(point).z;
        if (there - z).abs() > SAME_DEPTH * z {
            return false;
        }
        let (mine, others) = (point - self.camera.position(), point - camera.position());
        let (near, far) = (others.length(), mine.length());
        // In pixels of the two pictures, so that a longer lens counts as nearer.
        let far = far * camera.intrinsics().fx / self.camera.intrinsics().fx;
        far <= SIMILAR_DISTANCE * near && mine.dot(others) >= SIMILAR_DIRECTION * mine.length() * near
    }

    /// Share of the known points that one of the views in `all` saw as this one does, 0..1.
    pub(crate) fn covered(&self, all: &[Self]) -> f64 {
        let points: Vec<DVec3> = self.points().collect();
        let seen = points.par_iter().filter(|&&point| all.iter().any(|view| view.saw(point, &self.camera)));
        seen.count() as f64 / points.len().max(1) as f64
    }

    /// Share of the content that two views have in common, 0..1: the smaller of both shares.
    pub(crate) fn similarity(&self, other: &Self) -> f64 {
        self.share_in(&other.camera).min(other.share_in(&self.camera))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use gs_scene::Intrinsics;

    fn at(x: f64, z: f64) -> Footprint {
        let lens = Intrinsics { fx: 60.0, fy: 60.0, cx: 36.0, cy: 24.0, width: 72, height: 48 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-x, 0.0, -z)).unwrap();
        // A wall at z = 4.
        Footprint::new(&camera, &vec![(4.0 - z) as f32; 72 * 48])
    }

    #[test]
    fn views_share_what_both_see() {
        let here = at(0.0, 0.0);
        assert_eq!(here.similarity(&here), 1.0);
        // The wall is 4.8 wide in the picture: a step of a quarter of it leaves three quarters.
        assert!((here.similarity(&at(1.2, 0.0)) - 0.75).abs() < 0.03);
        assert_eq!(here.similarity(&at(9.0, 0.0)), 0.0);
        // From half the distance a quarter of it is in sight.
        assert!((here.similarity(&at(0.0, 2.0)) - 0.25).abs() < 0.05);
        assert_eq!(here.median(), Some(4.0));
    }

    #[test]
    fn what_was_seen_from_farther_away_is_not_covered() {
        let far = at(0.0, 0.0);
        assert!(at(0.1, 0.1).covered(std::slice::from_ref(&far)) > 0.95);
        assert_eq!(at(0.0, 2.5).covered(std::slice::from_ref(&far)), 0.0);
        // What stands before it hides it.
        let hidden = Footprint { depths: vec![1.0; POINTS], ..far };
        assert_eq!(at(0.0, 0.0).covered(&[hidden]), 0.0);
        assert_eq!(at(0.0, 0.0).covered(&[]), 0.0);
    }

    #[test]
    fn a_view_without_depth_covers_nothing() {
        let blind = Footprint { depths: vec![0.0; POINTS], ..at(0.0, 0.0) };
        assert_eq!((blind.median(), blind.share_in(&blind.camera)), (None, 0.0));
        assert_eq!(blind.filled(2.0).median(), Some(2.0));
    }
}
