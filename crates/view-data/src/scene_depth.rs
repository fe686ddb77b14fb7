//! The distance of the scene: stated by the file, or guessed from the poses.

use crate::{Dataset, DepthPercentiles, Error, Result};
use glam::{DMat3, DVec3};
use gs_scene::Camera;

/// Camera depths (z, scene units) between which the scene lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneDepth {
    /// Almost nothing is nearer.
    pub near: f64,
    /// Half of the content is nearer.
    pub median: f64,
    /// Almost nothing is farther.
    pub far: f64,
}

impl From<DepthPercentiles> for SceneDepth {
    /// The 2, 50 and 98 % depths.
    fn from(percentiles: DepthPercentiles) -> Self {
        Self { near: percentiles.p2, median: percentiles.p50, far: percentiles.p98 }
    }
}

impl SceneDepth {
    /// Checks that `0 < near <= median <= far < infinity`.
    ///
    /// # Errors
    /// If it is not so.
    pub fn check(self) -> Result<()> {
        let Self { near, median, far } = self;
        if near > 0.0 && near <= median && median <= far && far.is_finite() {
            return Ok(());
        }
        Err(Error::SceneDepth { near, median, far })
    }
}

/// Frames whose measured depth is read for the range of the whole scene.
const FRAMES_READ: usize = 8;
/// Every so many of their pixels counts: enough for percentiles.
const PIXEL_STEP: usize = 37;

impl Dataset {
    /// How far away the scene is as the data set knows it: what it states, else the depths of its points in the frames that see
    /// them, else the measured depth of up to 8 frames; `None` if it has none of them.
    ///
    /// # Errors
    /// If a file cannot be read or breaks a rule of its format.
    pub fn measured_depth(&self) -> Result<Option<DepthPercentiles>> {
        if self.depth_percentiles.is_some() {
            return Ok(self.depth_percentiles);
        }
        let mut depths: Vec<f32> = Vec::new();
        if let Some(points) = self.points()? {
            for point in &points {
                for seen in &point.observations {
                    let frame = self.frame(seen.frame)?;
                    depths.push((point.position - frame.position).dot(frame.axes.z_axis) as f32);
                }
            }
        }
        if depths.is_empty() {
            let with_depth: Vec<usize> =
                self.present().into_iter().filter(|&frame| self.frames[frame].depth.is_some()).collect();
            let count = with_depth.len().min(FRAMES_READ);
            for i in 0..count {
                // One at a time: they may be large.
                let view = self.load_views(&[with_depth[i * with_depth.len() / count]], None)?;
                let maps = view.iter().filter_map(gs_scene::View::depth);
                depths.extend(maps.flat_map(|depth| depth.data().iter().step_by(PIXEL_STEP)));
            }
        }
        Ok(DepthPercentiles::of(&mut depths))
    }
}

impl DepthPercentiles {
    /// Of depths in any order, which are sorted; those that are not above 0 and finite do not count. `None` if none is left.
    pub fn of(depths: &mut Vec<f32>) -> Option<Self> {
        depths.retain(|depth| *depth > 0.0 && depth.is_finite());
        depths.sort_unstable_by(f32::total_cmp);
        let last = depths.len().checked_sub(1)?;
        let percentile = |percent: f64| f64::from(depths[(last as f64 * 0.01 * percent).round() as usize]);
        Some(Self {
            p0_5: percentile(0.5),
            p2: percentile(2.0),
            p50: percentile(50.0),
            p98: percentile(98.0),
            p99_5: percentile(99.5),
        })
    }
}

/// A rough scene depth from the poses alone; `None` if the cameras tell nothing (fewer than two, or all in one place).
///
/// Where the viewing axes converge, the point nearest to all of them (least squares) is taken for the middle of
/// the scene, and its median depth over the cameras for the median; where they are nearly parallel, or diverge as
/// in a room seen from its middle, the median is twice the spread of the positions (root mean square distance from
/// their mean), or 30 steps from camera to nearest camera if that is less, as on a long walk. Near is 0.4 and far
/// 2 times the median.
///
/// This is good enough to tell which views overlap. It knows nothing of the pictures: a camera that circles a
/// bush in front of a wall gives the bush. On real captures the median is mostly right within a factor of 2, at
/// worst 3. Stereo needs a range estimated from matches.
#[must_use]
pub fn estimate_scene_depth(cameras: &[Camera]) -> Option<SceneDepth> {
    if cameras.len() < 2 {
        return None;
    }
    let median = focus_depth(cameras).or_else(|| spacing_depth(cameras))?;
    Some(SceneDepth { near: NEAR * median, median, far: FAR * median })
}

/// Near and far as multiples of the median. Scenes differ more than this in both directions.
const NEAR: f64 = 0.4;
const FAR: f64 = 2.0;
/// Median depth over the spread of the positions: 1.3 to 6 in real captures, mostly 1.5 to 3.
const DEPTH_PER_SPREAD: f64 = 2.0;
/// Median depth over the distance to the nearest camera, at most: real captures have 4 to 28.
const MAX_DEPTH_PER_STEP: f64 = 30.0;
/// Least mean squared sine of the angle between the axes and their common direction that gives a meeting point: 5
/// degrees.
const MIN_CONVERGENCE: f64 = 0.0076;
/// Least share of cameras that must have the meeting point in front.
const MIN_IN_FRONT: f64 = 0.8;

/// Median depth of the point nearest to all viewing axes.
fn focus_depth(cameras: &[Camera]) -> Option<f64> {
    // Minimises Σ |(I - d dᵀ)(x - c)|²; positions are taken from their mean to keep digits far from the origin.
    let count = cameras.len() as f64;
    let mean = cameras.iter().map(Camera::position).sum::<DVec3>() / count;
    let (mut along, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let axis = camera.forward();
        let projection = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        along += projection * count.recip();
        right += (DMat3::IDENTITY - projection) * (camera.position() - mean) * count.recip();
    }
    if 1.0 - largest_eigenvalue(&along) < MIN_CONVERGENCE {
        return None;
    }
    let matrix = DMat3::IDENTITY - along;
    let focus = mean + matrix.inverse() * right;
    let mut depths: Vec<f64> = cameras.iter().map(|camera| camera.to_camera(focus).z).collect();
    let in_front = depths.iter().filter(|&&depth| depth > 0.0).count() as f64;
    let depth = median(&mut depths)?;
    (in_front >= MIN_IN_FRONT * count && depth.is_finite()).then_some(depth)
}

/// Largest eigenvalue of a symmetric positive semi-definite matrix of trace 1, by power iteration.
fn largest_eigenvalue(matrix: &DMat3) -> f64 {
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let longest = columns.into_iter().fold(DVec3::ZERO, |a, b| if b.length() > a.length() { b } else { a });
    let vector = (0..50).fold(longest.normalize(), |vector, _| (*matrix * vector).normalize());
    vector.dot(*matrix * vector)
}

/// Median depth from the positions of the cameras.
fn spacing_depth(cameras: &[Camera]) -> Option<f64> {
    let positions: Vec<DVec3> = cameras.iter().map(Camera::position).collect();
    let nearest = |(i, &from): (usize, &DVec3)| {
        let others = positions.iter().enumerate().filter(|&(j, _)| j != i);
        others.map(|(_, to)| from.distance(*to)).filter(|&distance| distance > 0.0).reduce(f64::min)
    };
    let mut steps: Vec<f64> = positions.iter().enumerate().filter_map(nearest).collect();
    let step = median(&mut steps)?;
    let count = positions.len() as f64;
    let mean = positions.iter().sum::<DVec3>() / count;
    let spread =
        (positions.iter().map(|position| position.distance_squared(mean)).sum::<f64>() / count).sqrt();
    let depth = (DEPTH_PER_SPREAD * spread).min(MAX_DEPTH_PER_STEP * step);
    depth.is_finite().then_some(depth)
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
