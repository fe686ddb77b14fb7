//! How well the photographs determine their focal length.
//!
//! A camera that walks past a row of houses and looks the same way all along sees nearly the same with a long focal length and far houses as with
//! a short one and near houses. The covariance of the adjustment of all poses, lenses and points tells.

use crate::Photograph;
use crate::engine::Solution;
use glam::{DMat3, DVec2, DVec3};

/// Columns of a pose: a turn about the camera's axes, a shift along them.
const POSE: usize = 6;
/// Columns of a lens: the logarithm of the focal length, k1.
const LENS: usize = 2;
/// Added to the diagonal, as a share of it: the world can be turned, moved and scaled without a change in any picture.
const DAMPING: f64 = 1e-9;
/// A point whose rays are so nearly parallel says nothing: its smallest eigenvalue over the mean of the three.
const PARALLEL: f64 = 1e-8;
/// Change of a direction by which a lens is differentiated.
const STEP: f64 = 1e-6;

/// What one observation says: derivatives of its pixel by the columns of its photograph and its lens, and by its point.
struct Observed {
    photograph: usize,
    lens: usize,
    by_columns: [DVec2; POSE + LENS],
    by_point: [DVec2; 3],
}

/// Standard deviation of the logarithm of the focal length of each camera, in first order: that of an observation is the median distance of
/// the observations from where their points are drawn. None for cameras without posed photographs; infinite where nothing tells it.
pub(crate) fn uncertainties(solution: &Solution, photographs: &[Photograph]) -> Vec<Option<f64>> {
    let posed: Vec<usize> = (0..photographs.len()).filter(|&index| solution.poses[index].is_some()).collect();
    let count = posed.len();
    let mut column_of = vec![None; photographs.len()];
    for (column, &index) in posed.iter().enumerate() {
        column_of[index] = Some(column);
    }
    let columns = count * POSE + solution.lenses.len() * LENS;
    let mut matrix = vec![0.0; columns * columns];
    let mut distances = Vec::new();
    for point in &solution.points {
        let observed = point.observations.iter().filter_map(|seen| {
            let photograph = column_of[seen.frame]?;
            let lens = photographs[seen.frame].camera;
            let (observed, pixel) = observe(solution, (seen.frame, photograph, lens), point.position)?;
            distances.push((pixel - seen.pixel).length());
            Some(observed)
        });
        let observed: Vec<Observed> = observed.collect();
        if observed.len() > 1 {
            add_point(&mut matrix, columns, count, &observed);
        }
    }
    distances.sort_by(f64::total_cmp);
    let noise = distances.get(distances.len() / 2).copied().unwrap_or(f64::INFINITY);
    // What nothing was said of stands alone.
    let mut is_told = vec![true; columns];
    for i in 0..columns {
        let diagonal = &mut matrix[i * columns + i];
        is_told[i] = *diagonal > 0.0;
        *diagonal = if is_told[i] { *diagonal * (1.0 + DAMPING) } else { 1.0 };
    }
    let factor = cholesky(matrix, columns);
    let deviation = |lens: usize| {
        let column = count * POSE + lens * LENS;
        match &factor {
            Some(factor) if is_told[column] => noise * inverse_diagonal(factor, columns, column).sqrt(),
            _ => f64::INFINITY,
        }
    };
    let is_used = |lens: usize| posed.iter().any(|&index| photographs[index].camera == lens);
    (0..solution.lenses.len()).map(|lens| is_used(lens).then(|| deviation(lens))).collect()
}

/// The derivatives of an observation, and where its point is drawn.
fn observe(
    solution: &Solution,
    (frame, photograph, lens): (usize, usize, usize),
    point: DVec3,
) -> Option<(Observed, DVec2)> {
    let pose = solution.poses[frame]?;
    let to_camera = pose.axes.transpose();
    let camera_point = to_camera * (point - pose.position);
    if camera_point.z <= 0.0 {
        return None;
    }
    let camera_lens = &solution.lenses[lens];
    let direction = camera_point.truncate() / camera_point.z;
    let pixel = camera_lens.distort(direction);
    let by = |step: DVec2| {
        (camera_lens.distort(direction + step) - camera_lens.distort(direction - step)) / (2.0 * STEP)
    };
    let by_direction = [by(DVec2::X * STEP), by(DVec2::Y * STEP)];
    let by_at = |shift: DVec3| {
        let direction = (shift.truncate() - direction * shift.z) / camera_point.z;
        by_direction[0] * direction.x + by_direction[1] * direction.y
    };
    let gs_scene::Intrinsics { fx, fy, cx, cy, .. } = camera_lens.intrinsics;
    let by_k1 = DVec2::new(fx, fy) * direction * direction.length_squared();
    let observed = Observed {
        photograph,
        lens,
        by_columns: [
            by_at(DVec3::X.cross(camera_point)),
            by_at(DVec3::Y.cross(camera_point)),
            by_at(DVec3::Z.cross(camera_point)),
            by_at(DVec3::X),
            by_at(DVec3::Y),
            by_at(DVec3::Z),
            pixel - DVec2::new(cx, cy),
            by_k1,
        ],
        by_point: [by_at(to_camera.x_axis), by_at(to_camera.y_axis), by_at(to_camera.z_axis)],
    };
    pixel.is_finite().then_some((observed, pixel))
}

/// Adds what the observations of a point say of poses and lenses, the point itself eliminated.
fn add_point(matrix: &mut [f64], columns: usize, photographs: usize, observed: &[Observed]) {
    let mut of_point = DMat3::ZERO;
    for Observed { by_point: [x, y, z], .. } in observed {
        let column = |by: DVec2| DVec3::new(x.dot(by), y.dot(by), z.dot(by));
        of_point += DMat3::from_cols(column(*x), column(*y), column(*z));
    }
    let mean = (of_point.x_axis.x + of_point.y_axis.y + of_point.z_axis.z) / 3.0;
    // The determinant is the product of the eigenvalues, of which two are about the mean or above.
    let determinant = of_point.determinant();
    if determinant.is_nan() || determinant <= PARALLEL * mean.powi(3) {
        return;
    }
    let inverse = of_point.inverse();
    // Which columns, and their product with the point.
    let mut mixed: Vec<(usize, DVec3)> = Vec::with_capacity(observed.len() * (POSE + LENS));
    for Observed { photograph, lens, by_columns, by_point: [x, y, z] } in observed {
        let place = |column: usize| match column.checked_sub(POSE) {
            None => photograph * POSE + column,
            Some(of_lens) => photographs * POSE + lens * LENS + of_lens,
        };
        for (i, a) in by_columns.iter().enumerate() {
            mixed.push((place(i), DVec3::new(x.dot(*a), y.dot(*a), z.dot(*a))));
            for (j, b) in by_columns.iter().enumerate() {
                matrix[place(i) * columns + place(j)] += a.dot(*b);
            }
        }
    }
    for &(i, a) in &mixed {
        let a = inverse * a;
        for &(j, b) in &mixed {
            matrix[i * columns + j] -= a.dot(b);
        }
    }
}

/// The lower triangle L of a symmetric matrix L Lᵀ; None if it is not positive definite.
fn cholesky(mut matrix: Vec<f64>, columns: usize) -> Option<Vec<f64>> {
    for i in 0..columns {
        let (above, rest) = matrix.split_at_mut(i * columns);
        let row = &mut rest[..columns];
        for j in 0..i {
            let other = &above[j * columns..][..=j];
            let sum: f64 = row[..j].iter().zip(other).map(|(a, b)| a * b).sum();
            row[j] = (row[j] - sum) / other[j];
        }
        let rest = row[i] - row[..i].iter().map(|number| number * number).sum::<f64>();
        if rest.is_nan() || rest <= 0.0 {
            return None;
        }
        row[i] = rest.sqrt();
    }
    Some(matrix)
}

/// An entry of the diagonal of the inverse of L Lᵀ: the squared length of a column of L⁻¹.
fn inverse_diagonal(factor: &[f64], columns: usize, index: usize) -> f64 {
    let mut column = vec![0.0; columns];
    for i in index..columns {
        let row = &factor[i * columns..][..columns];
        let sum: f64 = row[index..i].iter().zip(&column[index..i]).map(|(a, b)| a * b).sum();
        column[i] = (f64::from(u8::from(i == index)) - sum) / row[i];
    }
    column.iter().map(|number| number * number).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Pose;
    use gs_scene::{Distortion, Intrinsics, Lens};
    use view_data::{Observation, ScenePoint};

    #[test]
    fn the_inverse_of_a_matrix() {
        let matrix = vec![4.0, 2.0, 0.4, 2.0, 5.0, 1.0, 0.4, 1.0, 3.0];
        let factor = cholesky(matrix, 3).unwrap();
        // By cofactors; the determinant is 4·14 - 2·5.6 + 0.4·0 = 44.8.
        for (index, cofactor) in [(0, 14.0), (1, 11.84), (2, 16.0)] {
            assert!((inverse_diagonal(&factor, 3, index) - cofactor / 44.8).abs() < 1e-12);
        }
        assert!(cholesky(vec![1.0, 2.0, 2.0, 1.0], 2).is_none());
        assert!(cholesky(vec![f64::NAN], 1).is_none());
    }

    /// Cameras on a line before a box of points, which turn by `turn` towards the middle of the box, seen with an error of half a pixel.
    fn walk(turn: f64) -> (Solution, Vec<Photograph>) {
        let (width, height) = (480, 360);
        let intrinsics = Intrinsics { fx: 400.0, fy: 400.0, cx: 240.0, cy: 180.0, width, height };
        let lens = Lens { intrinsics, model: Distortion { k1: 0.02, ..Distortion::default() }.into() };
        let pose = |i: usize| {
            let x = i as f64 * 0.1 - 0.4;
            Pose { axes: DMat3::from_rotation_y(-turn * x), position: DVec3::X * x }
        };
        let mut points = Vec::new();
        for i in 0..400u32 {
            let number = |k: u32| f64::from((i * 89 + k * 131 + i * i * k) % 997) / 997.0 - 0.5;
            let position = DVec3::new(number(1), number(2), 1.2 + 0.25 * number(3));
            let seen = |frame: usize| {
                let pose = pose(frame);
                let camera_point = pose.axes.transpose() * (position - pose.position);
                let error = DVec2::from_angle(f64::from(i) * 2.4 + frame as f64) * 0.5;
                Observation { frame, pixel: lens.distort(camera_point.truncate() / camera_point.z) + error }
            };
            let observations = (0..9).map(seen).collect();
            points.push(ScenePoint { position, colour: None, error: None, observations });
        }
        let poses = (0..9).map(|i| Some(pose(i))).collect();
        (
            Solution { lenses: vec![lens], poses, reasons: vec![None; 9], points },
            (0..9).map(|i| Photograph::of_size(&i.to_string(), [width, height])).collect(),
        )
    }

    #[test]
    fn a_camera_that_looks_one_way_hardly_tells_its_focal_length() {
        let deviation = |turn| {
            let (solution, photographs) = walk(turn);
            uncertainties(&solution, &photographs)[0].unwrap()
        };
        let [straight, turning] = [0.0, 0.8].map(deviation);
        assert!(straight > 10.0 * turning, "{straight} {turning}");
        assert!((1e-5..5e-3).contains(&turning), "{turning}");
        let (mut empty, photographs) = walk(0.5);
        empty.points.clear();
        assert_eq!(uncertainties(&empty, &photographs), [Some(f64::INFINITY)]);
        empty.poses.fill(None);
        assert_eq!(uncertainties(&empty, &photographs), [None]);
    }

    #[test]
    fn a_lens_that_nobody_used_is_unknown_and_changes_nothing() {
        let (mut solution, photographs) = walk(0.5);
        let alone = uncertainties(&solution, &photographs)[0].unwrap();
        solution.lenses.push(solution.lenses[0]);
        let both = uncertainties(&solution, &photographs);
        assert!((both[0].unwrap() - alone).abs() < 1e-9 * alone && both[1].is_none(), "{both:?} {alone}");
        // Photographs without a match, of a lens of their own: it is not known, and the other as before.
        let mut photographs = photographs;
        let mut other = photographs[0].clone();
        other.camera = 1;
        photographs.push(other);
        solution.poses.push(solution.poses[0]);
        solution.reasons.push(None);
        let both = uncertainties(&solution, &photographs);
        assert!((both[0].unwrap() - alone).abs() < 1e-6 * alone, "{both:?} {alone}");
        assert_eq!(both[1], Some(f64::INFINITY));
    }
}
