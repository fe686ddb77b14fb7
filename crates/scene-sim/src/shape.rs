//! Intersections of rays with the shapes, in f64 and in the shape's own axes. Every shape is convex: a ray is
//! inside it for one interval of its parameter.

use crate::Shape;
use glam::{DVec2, DVec3, Vec3};
use std::f64::consts::PI;

/// A point of a surface, in the axes of its shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    pub(crate) position: DVec3,
    /// Outward, unit length.
    pub(crate) normal: DVec3,
    pub(crate) face: Face,
    /// What the vertices of a mesh give this point, linear; white where there is no such colour.
    pub(crate) colour: Vec3,
}

/// Which part of the surface of a shape: what its texture is laid on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Face {
    /// Flat, perpendicular to this axis (0 to 2), on its positive or negative side.
    Flat { axis: usize, positive: bool },
    /// The round part of a sphere or cylinder.
    Round,
    /// A triangle of a mesh.
    Triangle,
}

/// What a pattern is laid on.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Canvas {
    Shape(Shape),
    Patch(Patch),
}

/// The plane of a triangle with texture coordinates that are linear on it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch {
    /// A point of the plane, in the mesh's axes, metres.
    pub(crate) origin: DVec3,
    /// The coordinates there, metres.
    pub(crate) at_origin: DVec2,
    /// How they grow with the position.
    pub(crate) gradients: [DVec3; 2],
    /// How far they reach over the whole mesh, metres.
    pub(crate) extent: DVec2,
}

impl Canvas {
    /// Texture coordinates of a place on (or next to) a face, and the extent of that face, metres: u to
    /// the right and v upwards for one who looks at it from outside, (0, 0) in its lower left corner.
    pub(crate) fn texture_coordinates(&self, face: Face, p: DVec3) -> (DVec2, DVec2) {
        match self {
            Self::Shape(shape) => shape.texture_coordinates(face, p),
            Self::Patch(patch) => {
                let grown = patch.gradients.map(|gradient| gradient.dot(p - patch.origin));
                (patch.at_origin + DVec2::from(grown), patch.extent)
            }
        }
    }
}

/// The interval in which the ray coordinate `o + t d` stays within ±`half`.
#[inline]
fn slab(o: f64, d: f64, half: f64) -> Option<(f64, f64)> {
    if d == 0.0 {
        return (o.abs() <= half).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let inverse = 1.0 / d;
    let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
    Some((a.min(b), a.max(b)))
}

#[inline]
fn meet(a: (f64, f64), b: (f64, f64)) -> Option<(f64, f64)> {
    let (enter, leave) = (a.0.max(b.0), a.1.min(b.1));
    (enter <= leave).then_some((enter, leave))
}

/// Where a ray is inside a ball (or, with the z components set to 0, inside an endless cylinder) around the
/// origin.
fn ball(o: DVec3, d: DVec3, radius: f64) -> Option<(f64, f64)> {
    let a = d.length_squared();
    let distance = o.length();
    let c = (distance - radius) * (distance + radius);
    if a == 0.0 {
        return (c <= 0.0).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let b = o.dot(d);
    // The discriminant from the part of `o` that is perpendicular to the ray: no cancellation for far
    // origins.
    let across = o - d * (b / a);
    let nearest = across.length();
    let chord = a * (radius - nearest) * (radius + nearest);
    if chord < 0.0 {
        return None;
    }
    // The root with the larger magnitude first; the other from their product.
    let q = -(b + chord.sqrt().copysign(b));
    if q == 0.0 {
        return Some((0.0, 0.0));
    }
    let (t0, t1) = (q / a, c / q);
    Some((t0.min(t1), t0.max(t1)))
}

impl Shape {
    /// Half the extents along its own axes, metres.
    #[inline]
    pub(crate) fn half(&self) -> DVec3 {
        0.5 * match *self {
            Self::Rectangle { width, height } => DVec3::new(width, height, 0.0),
            Self::Box { size } => size,
            Self::Sphere { radius } => DVec3::splat(2.0 * radius),
            Self::Cylinder { radius, height } => DVec3::new(2.0 * radius, 2.0 * radius, height),
        }
    }

    /// Whether there is nothing to be seen of it: at most one of its extents may be 0, and none of a
    /// sphere's.
    pub(crate) fn is_degenerate(&self) -> bool {
        self.half().to_array().into_iter().filter(|half| *half == 0.0).count() >= 2
    }

    /// Where the ray `o + t d` enters and leaves the shape; both are the same for what has no thickness.
    #[inline]
    pub(crate) fn interval(&self, o: DVec3, d: DVec3) -> Option<(f64, f64)> {
        match *self {
            Self::Rectangle { .. } | Self::Box { .. } => {
                let half = self.half();
                let xy = meet(slab(o.x, d.x, half.x)?, slab(o.y, d.y, half.y)?)?;
                // Both sides of a plate without thickness are the same crossing, whatever rounding says.
                meet(xy, slab(o.z, d.z, half.z)?)
            }
            Self::Sphere { radius } => ball(o, d, radius),
            Self::Cylinder { radius, height } => {
                let flat = |v: DVec3| DVec3::new(v.x, v.y, 0.0);
                meet(ball(flat(o), flat(d), radius)?, slab(o.z, d.z, 0.5 * height)?)
            }
        }
    }

    /// The point of the surface next to `p`, which is on it but for rounding, for a ray along `d`.
    pub(crate) fn surface(&self, p: DVec3, d: DVec3) -> SurfacePoint {
        let half = self.half();
        let round = match *self {
            Self::Rectangle { .. } | Self::Box { .. } => None,
            Self::Sphere { radius } => Some((p, radius)),
            Self::Cylinder { radius, .. } => {
                let side = DVec3::new(p.x, p.y, 0.0);
                let to_side = (side.length() - radius).abs();
                (to_side < (p.z.abs() - half.z).abs()).then_some((side, radius))
            }
        };
        if let Some((radial, radius)) = round {
            let normal = radial.normalize_or(DVec3::Z);
            let position = normal * radius + (p - radial);
            return SurfacePoint { position, normal, face: Face::Round, colour: Vec3::ONE };
        }
        let gap = (p.abs() - half).abs();
        let axis = match *self {
            Self::Cylinder { .. } => 2,
            _ => gap
                .to_array()
                .iter()
                .enumerate()
                .fold(2, |best, (axis, g)| if *g < gap[best] { axis } else { best }),
        };
        // A plate without thickness shows the side that the ray meets.
        let positive = if half[axis] == 0.0 { d[axis] <= 0.0 } else { p[axis] > 0.0 };
        let sign = if positive { 1.0 } else { -1.0 };
        let (mut position, mut normal) = (p, DVec3::ZERO);
        position[axis] = sign * half[axis];
        normal[axis] = sign;
        SurfacePoint { position, normal, face: Face::Flat { axis, positive }, colour: Vec3::ONE }
    }

    /// See [`Canvas::texture_coordinates`].
    fn texture_coordinates(&self, face: Face, p: DVec3) -> (DVec2, DVec2) {
        let half = self.half();
        match face {
            Face::Flat { axis, positive } => {
                let side = if positive { 1.0 } else { -1.0 };
                let (u, v, extent) = match axis {
                    0 => (side * p.y, p.z, DVec2::new(half.y, half.z)),
                    1 => (-side * p.x, p.z, DVec2::new(half.x, half.z)),
                    _ => (side * p.x, p.y, DVec2::new(half.x, half.y)),
                };
                (DVec2::new(u, v) + extent, extent * 2.0)
            }
            // A shape has no triangles.
            Face::Round | Face::Triangle => {
                let radius = half.x;
                let turn = p.y.atan2(p.x) + PI;
                let v = match self {
                    Self::Sphere { .. } => {
                        radius * (p.z / p.length()).clamp(-1.0, 1.0).asin() + radius * PI * 0.5
                    }
                    _ => p.z + half.z,
                };
                let height = if matches!(self, Self::Sphere { .. }) { PI * radius } else { 2.0 * half.z };
                (DVec2::new(turn * radius, v), DVec2::new(2.0 * PI * radius, height))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shape() -> impl Strategy<Value = Shape> {
        let length = || 0.01..10.0f64;
        prop_oneof![
            (length(), length(), length()).prop_map(|(x, y, z)| Shape::Box { size: DVec3::new(x, y, z) }),
            length().prop_map(|radius| Shape::Sphere { radius }),
            (length(), length()).prop_map(|(radius, height)| Shape::Cylinder { radius, height }),
        ]
    }

    /// Signed distance-like membership, written independently of the intervals.
    fn inside(shape: &Shape, p: DVec3, slack: f64) -> bool {
        match *shape {
            Shape::Sphere { radius } => p.length() <= radius + slack,
            Shape::Cylinder { radius, height } => {
                p.x.hypot(p.y) <= radius + slack && p.z.abs() <= height / 2.0 + slack
            }
            Shape::Box { size } => (p.abs() - size / 2.0).max_element() <= slack,
            Shape::Rectangle { width, height } => {
                p.x.abs() <= width / 2.0 + slack && p.y.abs() <= height / 2.0 + slack && p.z.abs() <= slack
            }
        }
    }

    fn vector(range: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-range..range).prop_map(DVec3::from)
    }

    proptest! {
        #[test]
        fn the_interval_is_where_the_ray_is_inside(shape in shape(), o in vector(20.0), aim in vector(6.0)) {
            let d = (aim - o).normalize();
            let found = shape.interval(o, d);
            for i in 0..400 {
                let t = f64::from(i) * 0.2 - 40.0;
                let p = o + d * t;
                let within = found.is_some_and(|(enter, leave)| t >= enter && t <= leave);
                if within {
                    prop_assert!(inside(&shape, p, 1e-9));
                } else {
                    prop_assert!(!inside(&shape, p, -1e-9));
                }
            }
            if let Some((enter, _)) = found {
                let point = shape.surface(o + d * enter, d);
                prop_assert!((point.position - (o + d * enter)).length() < 1e-9);
                prop_assert!((point.normal.length() - 1.0).abs() < 1e-12);
                prop_assert!(point.normal.dot(d) < 1e-6, "a ray from outside meets the front");
                let (uv, extent) = shape.texture_coordinates(point.face, point.position);
                prop_assert!(uv.min_element() > -1e-6 && (uv - extent).max_element() < 1e-6);
            }
        }
    }

    #[test]
    fn rays_in_the_plane_of_a_face_and_through_edges_hit() {
        let cube = Shape::Box { size: DVec3::splat(2.0) };
        assert_eq!(cube.interval(DVec3::new(1.0, 0.0, -5.0), DVec3::Z), Some((4.0, 6.0)));
        assert_eq!(cube.interval(DVec3::new(1.0, 1.0, -5.0), DVec3::Z), Some((4.0, 6.0)));
        assert_eq!(cube.interval(DVec3::new(1.0 + 1e-12, 0.0, -5.0), DVec3::Z), None);
        let ball = Shape::Sphere { radius: 2.0 };
        assert_eq!(ball.interval(DVec3::new(0.0, 0.0, -5.0), DVec3::Z), Some((3.0, 7.0)));
        assert_eq!(ball.interval(DVec3::ZERO, DVec3::X * 2.0), Some((-1.0, 1.0)));
        let tube = Shape::Cylinder { radius: 1.0, height: 4.0 };
        assert_eq!(tube.interval(DVec3::new(0.5, 0.0, 9.0), -DVec3::Z), Some((7.0, 11.0)));
        assert_eq!(tube.interval(DVec3::new(1.5, 0.0, 9.0), -DVec3::Z), None);
        assert_eq!(tube.interval(DVec3::new(0.0, -3.0, 1.0), DVec3::Y), Some((2.0, 4.0)));
    }

    #[test]
    fn letters_on_every_face_read_from_left_to_right() {
        let shape = Shape::Box { size: DVec3::ONE };
        for axis in 0..3 {
            for positive in [false, true] {
                let mut normal = DVec3::ZERO;
                normal[axis] = if positive { 1.0 } else { -1.0 };
                let uv = |p| shape.texture_coordinates(Face::Flat { axis, positive }, p).0;
                let gradient = |k: usize| {
                    DVec3::from_array(std::array::from_fn(|i| uv(DVec3::AXES[i])[k] - uv(DVec3::ZERO)[k]))
                };
                assert_eq!(gradient(0).cross(gradient(1)), normal, "axis {axis} {positive}");
            }
        }
    }
}
