//! Polygons cut into triangles.

use crate::MeshRule;
use glam::{DVec2, DVec3, Vec3};

/// Concave polygons beyond this are refused: cutting them takes time with the square of their corners and more.
const MOST_CONCAVE: usize = 1024;

/// The triangles of a mesh in its own units.
#[derive(Debug, Default)]
pub(crate) struct Triangles {
    pub(crate) vertices: Vec<DVec3>,
    /// Linear, one per vertex or none at all.
    pub(crate) colours: Vec<Vec3>,
    /// Texture coordinates, one per vertex or none at all.
    pub(crate) coordinates: Vec<DVec2>,
    /// Indices of vertices, counter-clockwise from outside.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Polygons added so far: what errors count by.
    pub(crate) polygons: u64,
}

impl Triangles {
    /// Adds a polygon. A quad is cut along its shorter diagonal, a concave one along the diagonal that lies in it;
    /// a larger polygon as a fan if it is convex, by its ears if not.
    ///
    /// # Errors
    /// If it has fewer than three corners, names a vertex that is not there, or is concave with more than 1024 corners.
    pub(crate) fn push_polygon(&mut self, corners: &[u32]) -> Result<(), MeshRule> {
        let face = self.polygons;
        self.polygons += 1;
        let vertices = self.vertices.len() as u64;
        if let Some(&found) = corners.iter().find(|&&corner| u64::from(corner) >= vertices) {
            return Err(MeshRule::FaceIndex { face, found: found.into(), vertices });
        }
        match *corners {
            [] | [_] | [_, _] => return Err(MeshRule::FaceCorners { face, found: corners.len() as u64 }),
            [a, b, c] => self.faces.push([a, b, c]),
            [a, b, c, d] => {
                let cut = if self.cuts_at_second(corners) {
                    [[a, b, d], [b, c, d]]
                } else {
                    [[a, b, c], [a, c, d]]
                };
                self.faces.extend(cut);
            }
            _ if self.is_convex(corners) => {
                self.faces.extend(corners[1..].windows(2).map(|pair| [corners[0], pair[0], pair[1]]));
            }
            _ if corners.len() <= MOST_CONCAVE => self.cut_ears(corners),
            _ => return Err(MeshRule::FaceConcave { face, found: corners.len() as u64 }),
        }
        Ok(())
    }

    fn at(&self, corner: u32) -> DVec3 {
        self.vertices[corner as usize]
    }

    /// Whether a quad is cut from its second to its fourth corner, rather than from the first to the third.
    fn cuts_at_second(&self, corners: &[u32]) -> bool {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| self.at(corners[k]));
        let agree = |m: [DVec3; 3], n: [DVec3; 3]| {
            (m[1] - m[0]).cross(m[2] - m[0]).dot((n[1] - n[0]).cross(n[2] - n[0])) > 0.0
        };
        match (agree([a, b, c], [a, c, d]), agree([a, b, d], [b, c, d])) {
            (true, false) => false,
            (false, true) => true,
            _ => (d - b).length_squared() < (c - a).length_squared(),
        }
    }

    /// The sum of the cross products around a polygon: its normal, twice its area long (Newell).
    fn newell(&self, corners: &[u32]) -> DVec3 {
        let origin = self.at(corners[0]);
        let pairs = corners[1..].windows(2);
        pairs.map(|pair| (self.at(pair[0]) - origin).cross(self.at(pair[1]) - origin)).sum()
    }

    /// Twice the area of a corner's triangle, seen along the normal: below 0 where the polygon turns inwards.
    fn turn(&self, [a, b, c]: [u32; 3], normal: DVec3) -> f64 {
        let (a, b, c) = (self.at(a), self.at(b), self.at(c));
        (b - a).cross(c - b).dot(normal)
    }

    fn is_convex(&self, corners: &[u32]) -> bool {
        let (normal, count) = (self.newell(corners), corners.len());
        (0..count).all(|i| {
            let corner = [0, 1, 2].map(|k| corners[(i + k) % count]);
            self.turn(corner, normal) >= 0.0
        })
    }

    /// Cuts off one ear after the other: a corner that turns outwards and holds no other corner.
    fn cut_ears(&mut self, corners: &[u32]) {
        let normal = self.newell(corners);
        let mut left = corners.to_vec();
        while left.len() > 3 {
            let count = left.len();
            let corner = |i: usize| [left[(i + count - 1) % count], left[i], left[(i + 1) % count]];
            let is_ear = |i: &usize| {
                let [a, b, c] = corner(*i);
                let holds = |p: u32| {
                    [[a, b, p], [b, c, p], [c, a, p]].map(|t| self.turn(t, normal) >= 0.0) == [true; 3]
                };
                self.turn([a, b, c], normal) > 0.0
                    && !left.iter().any(|p| ![a, b, c].contains(p) && holds(*p))
            };
            // A polygon that crosses itself may have no ear: any corner goes.
            let ear = (0..count).find(is_ear).unwrap_or(1);
            let triangle = corner(ear);
            self.faces.push(triangle);
            left.remove(ear);
        }
        self.faces.push([left[0], left[1], left[2]]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn flat(points: &[[f64; 2]]) -> Triangles {
        let vertices = points.iter().map(|&[x, y]| DVec3::new(x, y, 0.3 * x - 0.2 * y)).collect();
        Triangles { vertices, ..Triangles::default() }
    }

    fn cut(points: &[[f64; 2]]) -> Vec<[u32; 3]> {
        let mut mesh = flat(points);
        let corners: Vec<u32> = (0..points.len() as u32).collect();
        mesh.push_polygon(&corners).unwrap();
        mesh.faces
    }

    /// Signed area in the plane.
    fn area(points: &[[f64; 2]], corners: &[u32]) -> f64 {
        let corner = |k: usize| points[corners[k % corners.len()] as usize];
        (0..corners.len())
            .map(|k| 0.5 * (corner(k)[0] * corner(k + 1)[1] - corner(k)[1] * corner(k + 1)[0]))
            .sum()
    }

    #[test]
    fn quads_are_cut_along_the_shorter_diagonal_and_inside_if_concave() {
        assert_eq!(cut(&[[0.0, 0.0], [1.0, 0.0], [3.0, 1.0], [0.0, 1.0]]), [[0, 1, 3], [1, 2, 3]]);
        assert_eq!(cut(&[[0.0, 0.0], [3.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), [[0, 1, 2], [0, 2, 3]]);
        // An arrow head whose notch is the fourth corner: the long diagonal lies outside.
        assert_eq!(cut(&[[0.0, 0.0], [5.0, 1.0], [0.0, 2.0], [4.0, 1.0]]), [[0, 1, 3], [1, 2, 3]]);
    }

    #[test]
    fn wrong_polygons_name_the_face_and_the_rule() {
        let mut mesh = flat(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
        mesh.push_polygon(&[0, 1, 2]).unwrap();
        assert_eq!(mesh.push_polygon(&[0, 1]).unwrap_err(), MeshRule::FaceCorners { face: 1, found: 2 });
        let index = MeshRule::FaceIndex { face: 2, found: 3, vertices: 3 };
        assert_eq!(mesh.push_polygon(&[0, 1, 3]).unwrap_err(), index);
        let saw: Vec<[f64; 2]> =
            (0..1100).map(|i| [f64::from(i), f64::from(i % 2)]).chain([[550.0, 9.0]]).collect();
        let corners: Vec<u32> = (0..1101).collect();
        let concave = MeshRule::FaceConcave { face: 0, found: 1101 };
        assert_eq!(flat(&saw).push_polygon(&corners).unwrap_err(), concave);
    }

    proptest! {
        /// A star around the origin with any radii is concave as a rule, and never crosses itself.
        #[test]
        fn triangles_of_a_polygon_cover_it_once(radii in prop::collection::vec(0.1..1.0f64, 3..40)) {
            let count = radii.len() as f64;
            let points: Vec<[f64; 2]> = radii.iter().enumerate().map(|(i, r)| {
                let (sine, cosine) = (std::f64::consts::TAU * i as f64 / count).sin_cos();
                [r * cosine, r * sine]
            }).collect();
            let all: Vec<u32> = (0..points.len() as u32).collect();
            let faces = cut(&points);
            prop_assert_eq!(faces.len(), points.len() - 2);
            let areas: Vec<f64> = faces.iter().map(|face| area(&points, face)).collect();
            // Turned the same way, and their sum is the polygon's: none overlaps another.
            prop_assert!(areas.iter().all(|a| *a > -1e-12));
            prop_assert!((areas.iter().sum::<f64>() - area(&points, &all)).abs() < 1e-9);
        }
    }
}
