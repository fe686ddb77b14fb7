//! Meshes in their place.

use super::body::turn;
use super::ledger::{Dropped, Omission};
use crate::mesh::polygons::Triangles;
use crate::shape::{Canvas, Face, Patch, SurfacePoint};
use crate::texture::Texture;
use crate::{Finish, Mesh};
use glam::{DMat3, DVec2, DVec3, Vec3};
use std::collections::HashMap;

/// A mesh without its vertices and faces, which lie with those of all meshes.
pub(super) struct PlacedMesh {
    pub(super) texture: Texture,
    /// Where its own origin is, relative to the middle of the scene.
    centre: DVec3,
    to_world: DMat3,
    /// The number of its first vertex among all.
    first: u32,
    /// Linear, one per vertex or none at all.
    colours: Vec<Vec3>,
    /// Texture coordinates, one per vertex or none at all.
    coordinates: Vec<DVec2>,
    /// The box around it in its own axes, metres: its lowest corner and its size.
    bounds: (DVec3, DVec3),
    /// The same for its texture coordinates.
    coordinate_bounds: (DVec2, DVec2),
    /// Whether it has no inside: some edge has a triangle on one side only.
    is_open: bool,
}

/// A mesh on its way into the scene.
pub(super) struct LooseMesh {
    mesh: PlacedMesh,
    triangles: Triangles,
    scale: f64,
    world_centre: DVec3,
}

impl LooseMesh {
    /// Drops triangles with two corners in one place; that leaves no gap, as the other two of their edges are one.
    pub(super) fn new(
        mesh: &Mesh,
        place: &str,
        mut triangles: Triangles,
        dropped: &mut Vec<Dropped>,
    ) -> Self {
        let before = triangles.faces.len();
        let vertices = &triangles.vertices;
        triangles.faces.retain(|face| {
            let [a, b, c] = face.map(|index| vertices[index as usize]);
            a != b && b != c && c != a
        });
        let count = (before - triangles.faces.len()) as u64;
        if count > 0 {
            dropped.push(Dropped { place: place.to_owned(), what: Omission::Triangles, count });
        }
        if triangles.faces.is_empty() {
            dropped.push(Dropped { place: place.to_owned(), what: Omission::Mesh, count: 1 });
        }
        let texture = Texture::new(&mesh.material);
        // Only glass asks, and the answer takes a while.
        let is_open = matches!(texture.finish(), Finish::Glass { .. }) && is_open(&triangles);
        let box_of = |points: &[DVec3]| {
            let low = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
            let high = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
            (low, high - low)
        };
        let (low, size) = box_of(vertices);
        let flat: Vec<DVec3> = triangles.coordinates.iter().map(|uv| uv.extend(0.0)).collect();
        let (low_uv, size_uv) = box_of(&flat);
        let placed = PlacedMesh {
            texture,
            centre: mesh.centre,
            to_world: turn(mesh.rotation),
            first: 0,
            colours: std::mem::take(&mut triangles.colours),
            coordinates: std::mem::take(&mut triangles.coordinates),
            bounds: (low * mesh.scale, size * mesh.scale),
            coordinate_bounds: (low_uv.truncate(), size_uv.truncate()),
            is_open,
        };
        Self { mesh: placed, triangles, scale: mesh.scale, world_centre: mesh.centre }
    }

    /// The box around it in the world; `None` if there is nothing to see.
    pub(super) fn world_bounds(&self) -> Option<(DVec3, DVec3)> {
        let seen = self.triangles.faces.iter().flatten();
        let place = |index: &u32| self.offset(self.triangles.vertices[*index as usize]) + self.world_centre;
        seen.map(|index| (place(index), place(index))).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// A vertex in the world's axes and metres, from the mesh's own origin.
    fn offset(&self, vertex: DVec3) -> DVec3 {
        self.mesh.to_world * (vertex * self.scale)
    }

    /// Moves it to its place in a scene with this middle: its vertices and faces are appended to those of all.
    pub(super) fn settle(
        mut self,
        middle: DVec3,
        vertices: &mut Vec<DVec3>,
        faces: &mut Vec<[u32; 3]>,
    ) -> PlacedMesh {
        // The origin first: its distance from the middle is rounded once, alike for every vertex.
        self.mesh.centre = self.world_centre - middle;
        self.mesh.first = vertices.len() as u32;
        vertices.extend(self.triangles.vertices.iter().map(|v| self.offset(*v) + self.mesh.centre));
        faces.extend(self.triangles.faces.iter().map(|face| face.map(|index| index + self.mesh.first)));
        self.mesh
    }

    pub(super) fn counts(&self) -> (usize, usize) {
        (self.triangles.vertices.len(), self.triangles.faces.len())
    }
}

/// Whether some edge is not shared by an even number of triangles. Vertices in one place are one vertex.
fn is_open(triangles: &Triangles) -> bool {
    let mut places: HashMap<[u64; 3], u32> = HashMap::new();
    let mut uses: HashMap<(u32, u32), u32> = HashMap::new();
    for face in &triangles.faces {
        let corners = face.map(|index| {
            // Adding zero turns -0 into 0.
            let place = (triangles.vertices[index as usize] + DVec3::ZERO).to_array().map(f64::to_bits);
            *places.entry(place).or_insert(index)
        });
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            *uses.entry((a.min(b), a.max(b))).or_insert(0) += 1;
        }
    }
    uses.values().any(|count| count % 2 == 1)
}

impl PlacedMesh {
    /// Whether it keeps light off what is behind it.
    pub(super) fn blocks_light(&self) -> bool {
        !matches!(self.texture.finish(), Finish::Glass { .. })
    }

    pub(super) fn is_open(&self) -> bool {
        self.is_open
    }

    pub(super) fn to_local(&self) -> DMat3 {
        self.to_world.transpose()
    }

    /// The point of a triangle with these weights of its corners (relative to the middle of the scene), in the axes of
    /// the mesh, and what a pattern is laid on there.
    pub(super) fn point(
        &self,
        face: [u32; 3],
        corners: [DVec3; 3],
        weights: [f64; 3],
    ) -> (SurfacePoint, Canvas) {
        let to_local = self.to_local();
        let [a, b, c] = corners.map(|corner| to_local * (corner - self.centre));
        let position = a * weights[0] + b * weights[1] + c * weights[2];
        let area = (b - a).cross(c - a);
        // A triangle whose corners are in line has no side; any across its length will do.
        let normal =
            area.try_normalize().unwrap_or_else(|| (b - a).any_orthogonal_vector().normalize_or(DVec3::Z));
        let indices = face.map(|index| (index - self.first) as usize);
        let colour = if self.colours.is_empty() {
            Vec3::ONE
        } else {
            let parts =
                indices.iter().zip(weights).map(|(&index, weight)| self.colours[index] * weight as f32);
            parts.sum()
        };
        let patch = if self.coordinates.is_empty() {
            self.projected(position, normal)
        } else {
            self.mapped(indices, [a, b, c], area)
        };
        (SurfacePoint { position, normal, face: Face::Triangle, colour }, Canvas::Patch(patch))
    }

    /// Texture coordinates by the axis along which the normal is longest, as on a box.
    fn projected(&self, position: DVec3, normal: DVec3) -> Patch {
        let size = normal.abs();
        let axis = if size.z >= size.x && size.z >= size.y { 2 } else { usize::from(size.y > size.x) };
        let side = if normal[axis] < 0.0 { -1.0 } else { 1.0 };
        let [right, up] = match axis {
            0 => [DVec3::Y * side, DVec3::Z],
            1 => [DVec3::X * -side, DVec3::Z],
            _ => [DVec3::X * side, DVec3::Y],
        };
        let (low, extent) = self.bounds;
        let lowest = |along: DVec3| (low * along).min((low + extent) * along).dot(DVec3::ONE);
        let at_origin = [right, up].map(|along| along.dot(position) - lowest(along));
        let extent = [right, up].map(|along| along.abs().dot(extent));
        Patch {
            origin: position,
            at_origin: DVec2::from(at_origin),
            gradients: [right, up],
            extent: DVec2::from(extent),
        }
    }

    /// The mesh's own texture coordinates; one unit of them is a metre.
    fn mapped(&self, indices: [usize; 3], [a, b, c]: [DVec3; 3], area: DVec3) -> Patch {
        let (low, extent) = self.coordinate_bounds;
        let [at_a, at_b, at_c] = indices.map(|index| self.coordinates[index] - low);
        let square = area.length_squared().max(f64::MIN_POSITIVE);
        let across = [(c - a).cross(area) / square, area.cross(b - a) / square];
        let gradient = |k: usize| across[0] * (at_b - at_a)[k] + across[1] * (at_c - at_a)[k];
        Patch { origin: a, at_origin: at_a, gradients: [gradient(0), gradient(1)], extent }
    }
}
