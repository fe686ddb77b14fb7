//! Intersections of rays with triangles, without gaps between neighbours.
//!
//! The corners are moved into a frame in which the ray runs along an axis from the origin (Woop, Benthin, Wald:
//! Watertight Ray/Triangle Intersection, JCGT 2013). A corner's place there depends on nothing but itself and the
//! ray, so all triangles around it see the same place. Whether the ray passes an edge on its left or right is the
//! comparison of two products, each rounded once: rounding keeps their order or makes them equal, and swapping the
//! ends of the edge turns the answer round exactly. What passes one triangle at its edge therefore meets the
//! neighbour, and a ray through an edge or a corner meets all triangles there.

use super::PathRay;
use glam::DVec3;

/// A ray with what its tests against triangles share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    origin: [f64; 3],
    /// The axis along which the direction is longest, and the two after it.
    axes: [usize; 3],
    /// The direction along the second and third of the axes, as shares of that along the first.
    slopes: [f64; 2],
    /// 1 over the direction along the first of the axes.
    inverse: f64,
}

/// Where a ray crosses a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// In lengths of the ray's direction; may be negative.
    pub(super) t: f64,
    /// Shares of the three corners in the point.
    pub(super) weights: [f64; 3],
}

impl Aim {
    #[inline]
    pub(super) fn new(ray: &PathRay) -> Self {
        let d = ray.direction.to_array();
        let size = d.map(f64::abs);
        let first = if size[0] >= size[1] && size[0] >= size[2] {
            0
        } else if size[1] >= size[2] {
            1
        } else {
            2
        };
        let axes = [first, (first + 1) % 3, (first + 2) % 3];
        let inverse = 1.0 / d[first];
        let slopes = [d[axes[1]] * inverse, d[axes[2]] * inverse];
        Self { origin: ray.origin.to_array(), axes, slopes, inverse }
    }

    /// Across the ray (two numbers) and along it, from its start.
    #[inline(always)]
    fn place<const FIRST: usize>(&self, corner: &DVec3) -> [f64; 3] {
        let p = corner.to_array();
        let along = p[FIRST] - self.origin[FIRST];
        let [second, third] = [(FIRST + 1) % 3, (FIRST + 2) % 3];
        [
            (p[second] - self.origin[second]) - self.slopes[0] * along,
            (p[third] - self.origin[third]) - self.slopes[1] * along,
            along,
        ]
    }

    #[inline(always)]
    fn cross<const FIRST: usize>(&self, [a, b, c]: [&DVec3; 3]) -> Option<Crossing> {
        let [a, b, c] = [a, b, c].map(|corner| self.place::<FIRST>(corner));
        let side = |p: &[f64; 3], q: &[f64; 3]| p[0] * q[1] - p[1] * q[0];
        let (u, v, w) = (side(&b, &c), side(&c, &a), side(&a, &b));
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        // Seen from the side, a triangle is nothing but its edges, which its neighbours have too.
        if sum == 0.0 {
            return None;
        }
        let weights = [u / sum, v / sum, w / sum];
        let along = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2];
        Some(Crossing { t: along * self.inverse, weights })
    }

    /// Where the ray's line crosses the triangle, from either side.
    #[inline(always)]
    pub(super) fn crossing(&self, corners: [&DVec3; 3]) -> Option<Crossing> {
        match self.axes[0] {
            0 => self.cross::<0>(corners),
            1 => self.cross::<1>(corners),
            _ => self.cross::<2>(corners),
        }
    }
}
