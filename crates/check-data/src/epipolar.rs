//! Epipolar geometry under given poses, in f64.

use super::matching::Match;
#[cfg(test)]
use glam::DVec2;
use glam::{DMat3, DVec3};
use gs_scene::Intrinsics;

/// A pinhole and its pose as some reading of the files has it; not checked, because some readings are wrong.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Posed {
    /// Pixels of the picture that matches are measured in.
    pub(crate) intrinsics: Intrinsics,
    /// The camera's x (right), y (down), z (forward) axis in the world, as columns.
    pub(crate) axes: DMat3,
    /// Scene units.
    pub(crate) position: DVec3,
}

impl Posed {
    /// Pixels to directions of unit z-depth in the camera's frame.
    fn inverse_matrix(&self) -> DMat3 {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        DMat3::from_cols_array(&[1.0 / fx, 0.0, 0.0, 0.0, 1.0 / fy, 0.0, -cx / fx, -cy / fy, 1.0])
    }

    /// The pixel of a world point; meaningless behind the camera.
    #[cfg(test)]
    pub(crate) fn project(&self, world: DVec3) -> DVec2 {
        let p = self.axes.transpose() * (world - self.position);
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        DVec2::new(fx * p.x / p.z + cx, fy * p.y / p.z + cy)
    }
}

/// The matrix F with `second' F first = 0` for homogeneous pixels of one world point; zero if both are in one
/// place.
pub(crate) fn fundamental(first: &Posed, second: &Posed) -> DMat3 {
    let to_second = second.axes.transpose();
    let rotation = to_second * first.axes;
    let t = to_second * (first.position - second.position);
    // A baseline is a direction here; its length would only push F towards the ends of the number range.
    let t = t.try_normalize().unwrap_or(DVec3::ZERO);
    let cross = DMat3::from_cols_array(&[0.0, t.z, -t.y, -t.z, 0.0, t.x, t.y, -t.x, 0.0]);
    second.inverse_matrix().transpose() * cross * rotation * first.inverse_matrix()
}

/// Mean of the two distances, pixels, of the points of a match from the epipolar lines that they have in each
/// other's picture. Infinite where there is no line.
pub(crate) fn symmetric_distance(fundamental: &DMat3, found: &Match) -> f64 {
    let (a, b) = (found.first.extend(1.0), found.second.extend(1.0));
    let (line_b, line_a) = (*fundamental * a, fundamental.transpose() * b);
    let error = b.dot(line_b).abs();
    let distance = 0.5 * (error / line_b.truncate().length() + error / line_a.truncate().length());
    if distance.is_nan() { f64::INFINITY } else { distance }
}

/// Distance of the second point of a match, pixels, from where the first one is seen after a mere turn of the
/// camera: what is left of epipolar geometry without a baseline.
pub(crate) fn turn_distance(first: &Posed, second: &Posed, found: &Match) -> f64 {
    let ray = second.axes.transpose() * first.axes * first.inverse_matrix() * found.first.extend(1.0);
    let Intrinsics { fx, fy, cx, cy, .. } = second.intrinsics;
    let seen = glam::DVec2::new(fx * ray.x / ray.z + cx, fy * ray.y / ray.z + cy);
    let distance = seen.distance(found.second);
    if ray.z > 0.0 && distance.is_finite() { distance } else { f64::INFINITY }
}

/// A match seen as a point of the scene.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangulated {
    /// z-depth in the first camera, scene units; negative behind it.
    pub(crate) first: f64,
    /// z-depth in the second camera.
    pub(crate) second: f64,
    /// Angle between the two rays, radians, 0..pi.
    pub(crate) angle: f64,
}

/// Where the rays of a match come nearest to each other; `None` for parallel ones.
pub(crate) fn triangulate(first: &Posed, second: &Posed, found: &Match) -> Option<Triangulated> {
    let ray = |posed: &Posed, pixel: glam::DVec2| posed.axes * (posed.inverse_matrix() * pixel.extend(1.0));
    let (a, b) = (ray(first, found.first), ray(second, found.second));
    let between = second.position - first.position;
    // Least squares of |first + s a - second - t b|.
    let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
    let determinant = aa * bb - ab * ab;
    if determinant <= 1e-14 * aa * bb {
        return None;
    }
    let (pa, pb) = (between.dot(a), between.dot(b));
    Some(Triangulated {
        first: (pa * bb - pb * ab) / determinant,
        second: (pa * ab - pb * aa) / determinant,
        angle: a.angle_between(b),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(fx: f64) -> Intrinsics {
        Intrinsics { fx, fy: fx * 1.1, cx: 150.0, cy: 130.0, width: 320, height: 240 }
    }

    prop_compose! {
        fn cameras()(
            fx in 150.0f64..600.0,
            angles in prop::array::uniform3(-0.5f64..0.5),
            start in prop::array::uniform3(-3.0f64..3.0),
            between in prop::array::uniform3(-1.0f64..1.0),
        ) -> (Posed, Posed) {
            let [x, y, z] = angles;
            let turn = DMat3::from_euler(glam::EulerRot::XYZ, z, x, y);
            let start = DVec3::from_array(start);
            let first = Posed { intrinsics: lens(fx), axes: turn, position: start };
            let axes = turn * DMat3::from_euler(glam::EulerRot::XYZ, x, y, z);
            // Never nearer than 0.3, so that the tolerances are those of rounding.
            let between = DVec3::from_array(between) + DVec3::splat(0.3).copysign(DVec3::from_array(between));
            (first, Posed { intrinsics: lens(fx * 1.3), axes, position: start + between })
        }
    }

    proptest! {
        /// Against the definitions: a world point projected twice lies on its lines and is found again.
        #[test]
        fn world_points_lie_on_their_lines(
            (first, second) in cameras(),
            coordinates in prop::array::uniform2(20.0f64..220.0),
            depth in 2.0f64..20.0,
        ) {
            let pixel = DVec2::from_array(coordinates);
            let world = first.position + first.axes * (first.inverse_matrix() * pixel.extend(1.0)) * depth;
            let seen = second.axes.transpose() * (world - second.position);
            prop_assume!(seen.z > 0.5);
            let found = Match { first: pixel, second: second.project(world) };
            prop_assert!(first.project(world).distance(pixel) < 1e-8);
            let matrix = fundamental(&first, &second);
            let distance = symmetric_distance(&matrix, &found);
            // Near an epipole a line is short of digits.
            prop_assert!(distance < 1e-6, "{}", distance);
            let Some(point) = triangulate(&first, &second, &found) else { return Ok(()) };
            prop_assume!(point.angle > 0.01);
            prop_assert!((point.first / depth - 1.0).abs() < 1e-6, "{:?}", point);
            prop_assert!((point.second / seen.z - 1.0).abs() < 1e-6, "{:?}", point);
        }

        /// A point moved off its line by some pixels is that far away, whichever picture is first.
        #[test]
        fn distances_are_pixels_and_symmetric(
            (first, second) in cameras(),
            coordinates in prop::array::uniform2(20.0f64..220.0),
            off in 0.1f64..50.0,
        ) {
            let matrix = fundamental(&first, &second);
            let a = DVec2::from_array(coordinates);
            let line = matrix * a.extend(1.0);
            let normal = line.truncate() / line.truncate().length();
            prop_assume!(normal.is_finite());
            // The point of the line nearest to the picture's centre, moved off along the normal.
            let centre = DVec2::new(160.0, 120.0);
            let on_line = centre - normal * (line.dot(centre.extend(1.0)) / line.truncate().length());
            prop_assume!(on_line.length() < 1e4);
            let found = Match { first: a, second: on_line + normal * off };
            let back = Match { first: found.second, second: a };
            let line_a = matrix.transpose() * found.second.extend(1.0);
            let distance_a = (line_a.dot(a.extend(1.0)) / line_a.truncate().length()).abs();
            let expected = 0.5 * (off + distance_a);
            let distance = symmetric_distance(&matrix, &found);
            prop_assert!((distance / expected - 1.0).abs() < 1e-6, "{} {}", distance, expected);
            let reversed = symmetric_distance(&fundamental(&second, &first), &back);
            prop_assert!((reversed / distance - 1.0).abs() < 1e-6, "{} {}", reversed, distance);
        }
    }

    #[test]
    fn cameras_in_one_place_have_no_lines_but_a_turn() {
        let first = Posed { intrinsics: lens(300.0), axes: DMat3::IDENTITY, position: DVec3::ONE };
        let second = Posed { axes: DMat3::from_rotation_y(0.2), ..first };
        let world = DVec3::new(1.3, 1.1, 6.0);
        let found = Match { first: first.project(world), second: second.project(world) };
        assert_eq!(symmetric_distance(&fundamental(&first, &second), &found), f64::INFINITY);
        assert!(turn_distance(&first, &second, &found) < 1e-9);
        let behind = Posed { axes: DMat3::from_rotation_y(3.0), ..first };
        assert_eq!(turn_distance(&first, &behind, &found), f64::INFINITY);
        assert!(triangulate(&first, &first, &Match { second: found.first, ..found }).is_none());
    }
}
