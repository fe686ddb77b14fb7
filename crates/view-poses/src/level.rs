//! Up, origin and scale: an engine's world has none.

use crate::engine::Solution;
use crate::estimate::RECORD;
use crate::{Error, LevellingFault, Result};
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What an engine's world was turned, moved and scaled by: `p_new = scale · rotation · (p_old - origin)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Levelling {
    /// How up was found; it is +z afterwards.
    pub up: Up,
    /// Rotation, row by row.
    pub rotation: [[f64; 3]; 3],
    /// The median of the points, in the engine's world.
    pub origin: [f64; 3],
    /// The unit afterwards is the median distance of the points from the cameras that see them.
    pub scale: f64,
}

/// How up was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Up {
    /// Perpendicular to the horizontal axes of all cameras.
    Horizon,
    /// The mean of the cameras' up.
    Cameras,
    /// Not found: the cameras agree in nothing. The world is turned as the engine left it.
    Unknown,
}

/// Share of the second smallest of the variances of the cameras' x axes that the smallest may have at most, for the axes to lie in a plane.
const PLANE: f64 = 0.2;
/// The second smallest variance must be as large, per camera, for the plane to be defined.
const SPREAD: f64 = 0.02;
/// Length of the mean of the cameras' up from which on they agree.
const AGREE: f64 = 0.3;

impl Levelling {
    /// That of a data set which [`estimate_poses`](crate::estimate_poses) wrote, from its `poses.json`, or from the folder that has it.
    ///
    /// # Errors
    /// If the file cannot be read, or holds no levelling: a rotation, an origin and a scale above 0, all finite.
    pub fn read(path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Record {
            levelling: Levelling,
        }
        let path = if path.is_dir() { path.join(RECORD) } else { path.to_path_buf() };
        let text = std::fs::read(&path);
        let text = text.map_err(|source| Error::File { action: "read", path: path.clone(), source })?;
        let wrong = |source: LevellingFault| Error::NoLevelling { path: path.clone(), source };
        let Record { levelling } = serde_json::from_slice(&text).map_err(|error| wrong(error.into()))?;
        let Self { rotation, origin, scale, .. } = levelling;
        let turn = DMat3::from_cols_array_2d(&rotation);
        let is_turn =
            (turn * turn.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-6) && turn.determinant() > 0.0;
        if !is_turn {
            return Err(wrong(LevellingFault::Rotation { found: rotation }));
        }
        if !(scale > 0.0 && scale.is_finite() && origin.iter().all(|number| number.is_finite())) {
            return Err(wrong(LevellingFault::OriginOrScale { origin, scale }));
        }
        Ok(levelling)
    }

    /// Rotation, scale and translation, in this order, that undo it.
    #[must_use]
    pub fn undone(&self) -> (DQuat, f64, DVec3) {
        // Rows as columns are the inverse.
        let back = DQuat::from_mat3(&DMat3::from_cols_array_2d(&self.rotation)).normalize();
        (back, self.scale.recip(), DVec3::from_array(self.origin))
    }
}

/// Levels a solution in place; one without points keeps its scale.
pub(crate) fn level(solution: &mut Solution) -> Levelling {
    let (up, direction) = up(solution);
    let rotation = DQuat::from_rotation_arc(direction, DVec3::Z);
    let rotation = DMat3::from_quat(rotation);
    let origin = median_point(solution);
    let mut distances: Vec<f64> = Vec::new();
    for point in &solution.points {
        let seen = point.observations.iter().filter_map(|seen| solution.poses[seen.frame]);
        distances.extend(seen.map(|pose| (point.position - pose.position).length()));
    }
    distances.sort_by(f64::total_cmp);
    let middle =
        distances.get(distances.len() / 2).copied().filter(|middle| *middle > 0.0 && middle.is_finite());
    let scale = middle.map_or(1.0, f64::recip);
    for pose in solution.poses.iter_mut().flatten() {
        pose.axes = rotation * pose.axes;
        pose.position = rotation * (pose.position - origin) * scale;
    }
    for point in &mut solution.points {
        point.position = rotation * (point.position - origin) * scale;
    }
    let rows = rotation.transpose().to_cols_array_2d();
    Levelling { up, rotation: rows, origin: origin.to_array(), scale }
}

fn up(solution: &Solution) -> (Up, DVec3) {
    let poses = || solution.poses.iter().flatten();
    let count = poses().count().max(1) as f64;
    let mean_up = poses().map(|pose| -pose.axes.y_axis).sum::<DVec3>() / count;
    let mean_back = poses().map(|pose| -pose.axes.z_axis).sum::<DVec3>() / count;
    let mut scatter = DMat3::ZERO;
    for pose in poses() {
        let x = pose.axes.x_axis;
        scatter += DMat3::from_cols(x * x.x, x * x.y, x * x.z);
    }
    let (values, vectors) = eigen(scatter * count.recip());
    if values[1] > SPREAD && values[0] < PLANE * values[1] {
        let normal = vectors[0];
        // Cameras that look straight down have no up of their own, but look at the ground from above.
        let side = if mean_up.dot(normal).abs() > AGREE { mean_up } else { mean_back };
        return (Up::Horizon, if side.dot(normal) < 0.0 { -normal } else { normal });
    }
    if mean_up.length() > AGREE { (Up::Cameras, mean_up.normalize()) } else { (Up::Unknown, DVec3::Z) }
}

/// Eigenvalues, increasing, and eigenvectors of a symmetric matrix, by Jacobi's rotations.
fn eigen(mut matrix: DMat3) -> ([f64; 3], [DVec3; 3]) {
    let mut vectors = DMat3::IDENTITY;
    // Each sweep squares what is left beside the diagonal.
    for _ in 0..16 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = matrix.col(q)[p];
            if off.abs() < 1e-300 {
                continue;
            }
            let theta = 0.5 * (2.0 * off).atan2(matrix.col(q)[q] - matrix.col(p)[p]);
            let (sin, cos) = theta.sin_cos();
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = cos;
            turn.col_mut(q)[q] = cos;
            turn.col_mut(q)[p] = sin;
            turn.col_mut(p)[q] = -sin;
            matrix = turn.transpose() * matrix * turn;
            vectors *= turn;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| matrix.col(a)[a].total_cmp(&matrix.col(b)[b]));
    (order.map(|i| matrix.col(i)[i]), order.map(|i| vectors.col(i)))
}

fn median_point(solution: &Solution) -> DVec3 {
    let mut origin = DVec3::ZERO;
    if solution.points.is_empty() {
        return origin;
    }
    for axis in 0..3 {
        let mut values: Vec<f64> = solution.points.iter().map(|point| point.position[axis]).collect();
        values.sort_by(f64::total_cmp);
        origin[axis] = values[values.len() / 2];
    }
    origin
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Pose;
    use view_data::{Observation, ScenePoint};

    /// Cameras at `places` that look at the origin, with the world's `up`; a point there.
    fn around(places: &[DVec3], up: DVec3) -> Solution {
        let pose = |&position: &DVec3| {
            let z = -position.normalize();
            let x = z.cross(up).normalize();
            Some(Pose { axes: DMat3::from_cols(x, z.cross(x), z), position })
        };
        let observations = (0..places.len()).map(|frame| Observation { frame, pixel: glam::DVec2::ZERO });
        let point = ScenePoint {
            position: DVec3::ZERO,
            colour: None,
            error: None,
            observations: observations.collect(),
        };
        Solution {
            lenses: Vec::new(),
            poses: places.iter().map(pose).collect(),
            reasons: vec![None; places.len()],
            points: vec![point],
        }
    }

    #[test]
    fn up_is_z_and_points_are_a_unit_away() {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.7, -0.4, 2.0);
        let places: Vec<DVec3> = (0..8)
            .map(|i| turn * (DVec3::new((f64::from(i) * 0.7).cos(), (f64::from(i) * 0.7).sin(), 0.5) * 4.0))
            .collect();
        let mut solution = around(&places, turn * DVec3::Z);
        let levelling = level(&mut solution);
        assert_eq!(levelling.up, Up::Horizon);
        for pose in solution.poses.iter().flatten() {
            assert!((pose.position.length() - 1.0).abs() < 1e-9);
            assert!(-pose.axes.y_axis.z > 0.8, "{pose:?}");
            assert!(pose.axes.x_axis.z.abs() < 1e-9);
        }
        // Said as it was done.
        let rotation = DMat3::from_cols_array_2d(&levelling.rotation).transpose();
        let again = rotation * (places[3] - DVec3::from_array(levelling.origin)) * levelling.scale;
        assert!((again - solution.poses[3].unwrap().position).length() < 1e-12);
        let (turn, scale, translation) = levelling.undone();
        assert!((translation + scale * (turn * again) - places[3]).length() < 1e-12);
    }

    #[test]
    fn a_record_is_read_again_and_a_wrong_one_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut solution = around(&[DVec3::new(1.0, 3.0, 0.0), DVec3::new(0.0, 3.0, 0.1)], DVec3::Z);
        let levelling = level(&mut solution);
        let write = |levelling: Levelling| {
            let record = serde_json::json!({ "levelling": levelling, "engine": "any" });
            std::fs::write(folder.path().join(RECORD), record.to_string()).unwrap();
            Levelling::read(folder.path())
        };
        assert_eq!(write(levelling).unwrap(), levelling);
        let wrong = [
            Levelling { scale: 0.0, ..levelling },
            Levelling { scale: -1.0, ..levelling },
            Levelling { rotation: [[1.0, 0.0, 0.0]; 3], ..levelling },
            Levelling { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], ..levelling },
        ];
        for wrong in wrong {
            let said = write(wrong).unwrap_err().to_string();
            assert!(said.contains(RECORD), "{said}");
        }
        assert!(Levelling::read(&folder.path().join("none.json")).is_err());
    }

    #[test]
    fn cameras_that_look_down_stand_above_the_ground() {
        let mut solution = around(&[DVec3::new(0.0, 0.0, -5.0); 6], DVec3::X);
        for (i, pose) in solution.poses.iter_mut().flatten().enumerate() {
            let turned = DMat3::from_rotation_z(i as f64);
            pose.axes = turned * pose.axes;
        }
        assert_eq!(level(&mut solution).up, Up::Horizon);
        assert!(solution.poses[0].unwrap().position.z > 0.99, "{:?}", solution.poses[0]);
    }

    #[test]
    fn one_direction_gives_the_mean_of_ups_and_nothing_stays() {
        let mut solution = around(&[DVec3::new(0.0, 3.0, 0.0), DVec3::new(0.0, 3.0, 0.1)], DVec3::Z);
        assert_eq!(level(&mut solution).up, Up::Cameras);
        let mut empty = Solution { lenses: vec![], poses: vec![None], reasons: vec![None], points: vec![] };
        let levelling = level(&mut empty);
        assert_eq!((levelling.up, levelling.scale), (Up::Unknown, 1.0));
    }
}
