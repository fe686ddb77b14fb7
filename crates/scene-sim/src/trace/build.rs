//! Prepares a scene for ray tracing.

use super::body::Body;
use super::ledger::{Dropped, Omission};
use super::lights::{LampLight, SkyLight, SunLight};
use super::mesh::LooseMesh;
use super::{MARGIN, Slot, Traced};
use crate::check::check;
use crate::mesh::read::triangles_of;
use crate::{Error, Result, Scene};
use glam::DVec3;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::{Boundable, BvhBuildParams};
use std::path::Path;
use std::time::Duration;

/// Vertices, or triangles and bodies together, of one scene: what 31 bits number.
const MOST: u64 = (1 << 31) - 1;

/// A box of the hierarchy.
struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Bounds {
    /// Around a box in the unit frame.
    fn around(low: DVec3, high: DVec3) -> Self {
        Self(Aabb::new((low - MARGIN).as_vec3a(), (high + MARGIN).as_vec3a()))
    }
}

impl Traced {
    /// Checks a scene and makes it ready for rays. What cannot be seen is dropped, see [`Traced::dropped`].
    ///
    /// # Errors
    /// If a number of the description is not finite or out of its range, or a mesh comes from a file: use
    /// [`Traced::load`]. The error names the part of the scene and the field.
    pub fn new(scene: &Scene) -> Result<Self> {
        Self::build(scene, None)
    }

    /// [`Traced::new`] for a scene whose meshes may come from files relative to `folder`.
    ///
    /// # Errors
    /// As [`Traced::new`], and if a file cannot be read or breaks a rule of its format. The error names mesh, file and
    /// rule.
    pub fn load(scene: &Scene, folder: &Path) -> Result<Self> {
        Self::build(scene, Some(folder))
    }

    fn build(scene: &Scene, folder: Option<&Path>) -> Result<Self> {
        check(scene)?;
        let (mut bodies, mut loose, mut dropped) = (Vec::new(), Vec::new(), Vec::new());
        for (index, primitive) in scene.primitives.iter().enumerate() {
            match Body::of_primitive(primitive) {
                Some(body) => bodies.push(body),
                None => dropped.push(Dropped {
                    place: format!("primitive {index} ({})", primitive.name),
                    what: Omission::Primitive,
                    count: 1,
                }),
            }
        }
        for (index, mesh) in scene.meshes.iter().enumerate() {
            let place = format!("mesh {index} ({})", mesh.name);
            let triangles = triangles_of(mesh, &place, folder, &mut dropped)?;
            loose.push(LooseMesh::new(mesh, &place, triangles, &mut dropped));
        }
        bodies.extend(scene.lamps.iter().enumerate().filter_map(|(index, lamp)| Body::of_lamp(index, lamp)));
        let mut traced = Self {
            centre: DVec3::ZERO,
            radius: 0.0,
            slots: Vec::new(),
            vertices: Vec::new(),
            meshes: Vec::new(),
            bodies,
            hierarchy: None,
            sun: scene.sun.as_ref().and_then(SunLight::new),
            lamps: scene.lamps.iter().map(LampLight::new).collect(),
            sky: SkyLight::new(&scene.sky),
            dropped,
        };
        traced.settle(loose)?;
        traced.sort();
        Ok(traced)
    }

    /// Finds the middle of the scene and makes everything relative to it.
    fn settle(&mut self, loose: Vec<LooseMesh>) -> Result<()> {
        let (mut vertices, mut faces) = (0, 0);
        for mesh in &loose {
            let (more_vertices, more_faces) = mesh.counts();
            vertices += more_vertices as u64;
            faces += more_faces as u64;
        }
        let found = vertices.max(faces + self.bodies.len() as u64);
        if found > MOST {
            return Err(Error::TooLarge { found, most: MOST });
        }
        let of_bodies =
            self.bodies.iter().map(|body| (body.centre - body.reach(), body.centre + body.reach()));
        let boxes = of_bodies.chain(loose.iter().filter_map(LooseMesh::world_bounds));
        let Some((low, high)) = boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))) else { return Ok(()) };
        self.centre = 0.5 * (low + high);
        self.radius = 0.5 * (high - low).length();
        for body in &mut self.bodies {
            body.centre -= self.centre;
        }
        self.vertices.reserve_exact(vertices as usize);
        self.slots.reserve_exact(faces as usize + self.bodies.len());
        let mut corners = Vec::new();
        for mesh in loose {
            let owner = self.meshes.len() as u32;
            self.meshes.push(mesh.settle(self.centre, &mut self.vertices, &mut corners));
            self.slots.extend(corners.drain(..).map(|corners| Slot { corners, owner }));
        }
        let bodies = 0..self.bodies.len() as u32;
        self.slots.extend(bodies.map(|index| Slot { corners: [0; 3], owner: index | Slot::BODY }));
        Ok(())
    }

    /// Builds the hierarchy over the slots, and sorts them by it.
    fn sort(&mut self) {
        if self.slots.is_empty() {
            return;
        }
        let shrink = self.radius.recip();
        let bounds = |slot: &Slot| {
            if slot.owner & Slot::BODY != 0 {
                let body = &self.bodies[(slot.owner ^ Slot::BODY) as usize];
                let (centre, reach) = (body.centre * shrink, body.reach() * shrink);
                return Bounds::around(centre - reach, centre + reach);
            }
            let [a, b, c] = slot.corners.map(|index| self.vertices[index as usize] * shrink);
            Bounds::around(a.min(b).min(c), a.max(b).max(c))
        };
        let boxes: Vec<Bounds> = self.slots.iter().map(bounds).collect();
        let mut hierarchy = build_cwbvh(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        let order = std::mem::take(&mut hierarchy.primitive_indices);
        assert_eq!(order.len(), self.slots.len(), "the hierarchy names every slot once");
        self.slots = order.iter().map(|&index| self.slots[index as usize]).collect();
        self.hierarchy = Some(hierarchy);
    }
}
