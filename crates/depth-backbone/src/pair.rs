//! Two-view geometry: where a pixel of one view, at a given inverse depth, falls in another.

use glam::{DMat3, DVec3, Vec3};
use gs_scene::{Camera, Intrinsics};

fn calibration(lens: &Intrinsics) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(lens.fx, 0.0, 0.0),
        DVec3::new(0.0, lens.fy, 0.0),
        DVec3::new(lens.cx, lens.cy, 1.0),
    )
}

/// The map (pixel, inverse depth w) → homogeneous pixel `infinite · (u, v, 1) + epipole · w` of another view.
/// Built in f64 from relative poses, so scenes far from the origin lose nothing by the f32 arithmetic on pixels.
#[derive(Debug, Clone, Copy)]
pub struct Pair {
    /// `K_s R K_r⁻¹`: where the pixel falls when it is infinitely far.
    infinite: [DVec3; 3],
    /// `K_s t`.
    epipole: DVec3,
}

impl Pair {
    /// From `reference` to `source`.
    #[must_use]
    pub fn new(reference: &Camera, source: &Camera) -> Self {
        let rotation = source.rotation() * reference.rotation().transpose();
        // t = R_s (c_r - c_s): from the camera centres, not from the translations, which may be huge.
        let translation = source.rotation() * (reference.position() - source.position());
        let infinite =
            calibration(source.intrinsics()) * rotation * calibration(reference.intrinsics()).inverse();
        let epipole = calibration(source.intrinsics()) * translation;
        Self { infinite: [infinite.x_axis, infinite.y_axis, infinite.z_axis], epipole }
    }

    /// Homogeneous source pixel of the reference position (u, v) at inverse depth `w`. Its z times the depth is the
    /// z-depth in the source view.
    #[must_use]
    pub fn project(&self, u: f32, v: f32, w: f32) -> Vec3 {
        self.row(v).as_vec3() + self.step().as_vec3() * u + self.epipole.as_vec3() * w
    }

    /// The part of [`Self::project`] that is the same along an image row.
    pub(crate) fn row(&self, v: f32) -> DVec3 {
        self.infinite[1] * f64::from(v) + self.infinite[2]
    }

    /// The same at one inverse depth.
    pub(crate) fn row_of_plane(&self, v: f32, w: f64) -> DVec3 {
        self.row(v) + self.epipole * w
    }

    /// Change of [`Self::project`] by one pixel to the right.
    pub(crate) fn step(&self) -> DVec3 {
        self.infinite[0]
    }

    /// Where the centres of the pixels of a row lie that fall in a picture of so many pixels, at inverse depth `w`: from where to where. Of the rows
    /// with centres at `rows` it is what holds those of each; empty (the first number is larger) if there are none.
    pub(crate) fn seen(
        &self,
        rows: impl Iterator<Item = f64>,
        w: f64,
        [width, height]: [usize; 2],
    ) -> [f64; 2] {
        // A place falls in it where none of these numbers is negative. They are sums of what x, y and the rest add.
        let sides = |h: DVec3| [h.z, h.x, width as f64 * h.z - h.x, h.y, height as f64 * h.z - h.y];
        let [by_x, by_y, rest] = [self.infinite[0], self.infinite[1], self.row_of_plane(0.0, w)].map(sides);
        let nothing = [f64::INFINITY, f64::NEG_INFINITY];
        let of_row = |y: f64| {
            let mut seen = [f64::NEG_INFINITY, f64::INFINITY];
            for k in 0..by_x.len() {
                let at_zero = by_y[k] * y + rest[k];
                if by_x[k] > 0.0 {
                    seen[0] = seen[0].max(-at_zero / by_x[k]);
                } else if by_x[k] < 0.0 {
                    seen[1] = seen[1].min(-at_zero / by_x[k]);
                } else if at_zero < 0.0 {
                    return nothing;
                }
            }
            if seen[0] <= seen[1] { seen } else { nothing }
        };
        rows.map(of_row).fold(nothing, |all, seen| [all[0].min(seen[0]), all[1].max(seen[1])])
    }

    /// Change of [`Self::project`] by inverse depth.
    #[must_use]
    pub fn epipole(&self) -> DVec3 {
        self.epipole
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    #[test]
    fn equals_unprojection_and_projection_even_far_from_the_origin() {
        let lens = Intrinsics { fx: 310.0, fy: 290.0, cx: 150.0, cy: 111.0, width: 320, height: 240 };
        for offset in [0.0, 1e4] {
            let origin = DVec3::new(offset, -offset, offset);
            let a =
                Camera::looking_at(lens, origin, origin + DVec3::new(0.1, 0.2, 3.0), DVec3::NEG_Y).unwrap();
            let side = origin + DVec3::new(0.4, -0.1, 0.2);
            let b = Camera::looking_at(lens, side, origin + DVec3::new(0.0, 0.1, 4.0), DVec3::NEG_Y).unwrap();
            let pair = Pair::new(&a, &b);
            for (u, v, depth) in [(10.5, 20.5, 1.0), (160.0, 120.0, 3.0), (310.5, 230.5, 40.0)] {
                let world = a.unproject(DVec2::new(u, v), depth);
                let expected = b.project(world).unwrap();
                let h = pair.project(u as f32, v as f32, (1.0 / depth) as f32);
                assert!((f64::from(h.x / h.z) - expected.x).abs() < 2e-3, "offset {offset}");
                assert!((f64::from(h.y / h.z) - expected.y).abs() < 2e-3);
                assert!((f64::from(h.z) * depth - b.to_camera(world).z).abs() < 1e-4 * depth);
            }
        }
    }

    #[test]
    fn what_falls_in_the_other_picture_is_seen_and_hardly_more() {
        let lens = Intrinsics { fx: 60.0, fy: 55.0, cx: 30.0, cy: 21.0, width: 64, height: 40 };
        let a = Camera::looking_at(lens, DVec3::ZERO, DVec3::Z, DVec3::NEG_Y).unwrap();
        for (from, to) in [
            (DVec3::new(0.4, -0.1, 0.2), DVec3::new(0.0, 0.1, 4.0)),
            (DVec3::new(-2.0, 1.0, 3.0), DVec3::new(0.5, 0.0, 2.5)),
            (DVec3::new(0.0, 0.0, 6.0), DVec3::ZERO),
            (DVec3::new(0.0, 0.0, 6.0), DVec3::new(0.0, 0.0, 9.0)),
        ] {
            let pair = Pair::new(&a, &Camera::looking_at(lens, from, to, DVec3::NEG_Y).unwrap());
            for w in [0.0_f32, 0.05, 0.2, 0.5, 2.0] {
                let falls = |x: usize, y: usize| {
                    let h = pair.project(x as f32 + 0.5, y as f32 + 0.5, w);
                    h.z > 0.0 && (0.0..=64.0).contains(&(h.x / h.z)) && (0.0..=40.0).contains(&(h.y / h.z))
                };
                for rows in [0..40, 3..9, 17..18] {
                    let columns: Vec<usize> =
                        (0..64).filter(|&x| rows.clone().any(|y| falls(x, y))).collect();
                    let seen = pair.seen(rows.clone().map(|y| y as f64 + 0.5), w.into(), [64, 40]);
                    let expected: Vec<usize> =
                        (0..64).filter(|&x| (seen[0]..=seen[1]).contains(&(x as f64 + 0.5))).collect();
                    assert_eq!(columns, expected, "{from} {w} {rows:?}");
                }
            }
        }
        let nowhere =
            Pair::new(&a, &Camera::looking_at(lens, DVec3::ZERO, DVec3::NEG_Z, DVec3::NEG_Y).unwrap());
        let [from, to] = nowhere.seen([0.5, 20.5].into_iter(), 0.5, [64, 40]);
        assert!(from > to);
    }
}
