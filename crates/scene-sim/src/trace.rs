//! A scene prepared for ray tracing.
//!
//! The hierarchy (obvhs, f32) only decides which bodies a ray is tested against; the tests themselves are in
//! f64. The hierarchy lives in a frame of its own, in which the scene is the unit ball around the origin:
//! there the rounding of every f32 number has one bound, whatever the scene's place and scale, and the boxes
//! are grown by more than that bound.

mod body;
/// How a scene becomes ready for rays.
mod build;
mod ledger;
/// The lights, for shading.
mod lights;
mod mesh;
mod triangle;

use crate::shape::{Canvas, SurfacePoint};
use crate::texture::Texture;
use body::{Body, Skin};
use glam::{DMat3, DVec3, Vec3A};
pub use ledger::{Dropped, Omission};
pub(crate) use lights::on_disc;
use lights::{LampLight, SkyLight, SunLight};
use mesh::PlacedMesh;
use obvhs::cwbvh::CwBvh;
use obvhs::ray::{Ray, RayHit};
use triangle::Aim;

/// How far the boxes of the hierarchy are grown, in radii of the scene: about thirty times the rounding of
/// coordinates, quantised boxes and slab tests in f32 (each a few times 2^-24).
const MARGIN: f64 = 4e-6;
/// How far before its start a ray begins in the hierarchy, in radii: obvhs skips boxes that end within 1e-4
/// of the start.
const RUN_UP: f64 = 1e-3;
/// Shadow rays start this many units of rounding above the surface: the hit point is exact to about eight, and so is
/// the place of a triangle in the frame of a ray.
const OFFSET_ULPS: f64 = 64.0;

/// A scene made ready for rays: checked, centred, sorted into a hierarchy.
pub struct Traced {
    /// The middle of the scene in the world: all that follows is relative to it.
    centre: DVec3,
    /// Of the ball around the middle that holds everything; 0 for an empty scene.
    radius: f64,
    /// Triangles and bodies in the order of the hierarchy's leaves, so that a ray finds its candidates side by side.
    slots: Vec<Slot>,
    vertices: Vec<DVec3>,
    meshes: Vec<PlacedMesh>,
    bodies: Vec<Body>,
    hierarchy: Option<CwBvh>,
    pub(crate) sun: Option<SunLight>,
    /// In the order of the scene.
    pub(crate) lamps: Vec<LampLight>,
    pub(crate) sky: SkyLight,
    dropped: Vec<Dropped>,
}

/// What a leaf of the hierarchy holds.
#[derive(Debug, Clone, Copy)]
struct Slot {
    /// Vertices, for a triangle.
    corners: [u32; 3],
    /// The number of the mesh; for a body its number and [`Slot::BODY`].
    owner: u32,
}

impl Slot {
    const BODY: u32 = 1 << 31;
}

/// A ray relative to the middle of the scene; the direction may have any length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PathRay {
    pub(crate) origin: DVec3,
    pub(crate) direction: DVec3,
}

/// The nearest surface on a ray.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    /// In lengths of the ray's direction.
    pub(crate) t: f64,
    slot: usize,
}

/// What a ray meets. It lives on the stack, one at a time.
#[allow(clippy::large_enum_variant)]
pub(crate) enum Met<'a> {
    /// A surface with a material.
    Surface(Surface<'a>),
    /// The front of this lamp of the scene.
    Lamp(usize),
}

/// What shading needs of a hit.
pub(crate) struct Surface<'a> {
    /// Relative to the middle of the scene.
    pub(crate) position: DVec3,
    /// Towards the side that the ray came from, unit length.
    pub(crate) normal: DVec3,
    pub(crate) point: SurfacePoint,
    pub(crate) canvas: Canvas,
    pub(crate) texture: &'a Texture,
    /// World to shape axes.
    pub(crate) to_local: DMat3,
    /// Whether there is nothing behind it but its other side: a plate without thickness, or a mesh that is not closed
    /// (told for glass only). What is closed has an inside.
    pub(crate) is_thin: bool,
    /// Towards where the ray came from, unit length.
    backwards: DVec3,
    /// Largest coordinate that went into the position, metres: what its rounding is proportional to.
    magnitude: f64,
}

impl Surface<'_> {
    /// Whether a ray in this direction met it from inside its body.
    pub(crate) fn is_from_inside(&self, direction: DVec3) -> bool {
        self.point.normal.dot(self.to_local * direction) > 0.0
    }

    /// Where a ray that leaves the surface in this direction, on either of its sides, may start without meeting the
    /// surface itself: off the surface, and a little back along the ray that met it (on along it, if the new ray goes
    /// through). What that ray passed is free, so the start lies within a corner, not behind its other walls.
    pub(crate) fn departure(&self, direction: DVec3) -> DVec3 {
        let side = if direction.dot(self.normal) < 0.0 { -1.0 } else { 1.0 };
        let offset = side * OFFSET_ULPS * f64::EPSILON * self.magnitude;
        self.position + (self.normal + self.backwards) * offset
    }
}

impl Traced {
    /// What of the scene is not seen, in its order.
    #[must_use]
    pub fn dropped(&self) -> &[Dropped] {
        &self.dropped
    }

    /// A point of the world relative to the middle of the scene.
    pub(crate) fn relative(&self, world: DVec3) -> DVec3 {
        world - self.centre
    }

    /// The part of a ray inside the scene, in the unit frame of the hierarchy; with what turns a ray
    /// parameter into a parameter there. `None` if the ray misses the scene.
    fn enter(&self, ray: &PathRay) -> Option<(Ray, impl Fn(f64) -> f32)> {
        let length = ray.direction.length();
        let shrink = self.radius.recip();
        let speed = length * shrink;
        let direction = ray.direction * length.recip();
        let origin = ray.origin * shrink;
        let (mut start, mut end) = (0.0, 2.0);
        // A camera far outside would lose its place in f32: such a ray begins where it meets the unit ball.
        if origin.length_squared() > 1.0 {
            let middle = -origin.dot(direction);
            let chord = 1.0 + 2.0 * MARGIN - (origin + direction * middle).length_squared();
            if chord < 0.0 || middle + chord.sqrt() < 0.0 {
                return None;
            }
            (start, end) = ((middle - chord.sqrt()).max(0.0), middle + chord.sqrt());
        }
        start -= RUN_UP;
        end += RUN_UP;
        // Adding zero turns -0 into 0, whose sign obvhs reads in two different ways.
        let (from, along) = ((origin + direction * start).as_vec3a(), direction.as_vec3a() + Vec3A::ZERO);
        let ray = Ray::new(from, along, 0.0, (end - start) as f32);
        // Rounded up by more than the errors of the box tests, so that no nearer box is passed over.
        Some((ray, move |t: f64| ((t * speed - start) + MARGIN) as f32))
    }

    /// How far from `origin` the first surface lies, in lengths of `direction`; lamps are surfaces from their front.
    #[must_use]
    pub fn distance(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        self.nearest(&PathRay { origin: self.relative(origin), direction }).map(|hit| hit.t)
    }

    /// Whether something keeps light from `origin + direction` off `origin`. Glass and lamps do not. Both ends should
    /// lie off any surface.
    #[must_use]
    pub fn is_shadowed(&self, origin: DVec3, direction: DVec3) -> bool {
        self.is_blocked(&PathRay { origin: self.relative(origin), direction }, 1.0)
    }

    /// Where a ray first meets what a slot holds, nearer than `farthest`.
    #[inline(always)]
    fn first_hit(&self, slot: usize, ray: &PathRay, aim: &Aim, farthest: f64) -> Option<f64> {
        let Slot { corners, owner } = &self.slots[slot];
        if owner & Slot::BODY != 0 {
            return self.bodies[(owner ^ Slot::BODY) as usize].first_hit(ray).filter(|t| *t < farthest);
        }
        let corners = [0, 1, 2].map(|k| &self.vertices[corners[k] as usize]);
        let crossing = aim.crossing(corners).filter(|crossing| crossing.t > 0.0 && crossing.t < farthest)?;
        let mesh = &self.meshes[*owner as usize];
        if mesh.texture.has_holes() {
            let (point, canvas) = mesh.point(self.slots[slot].corners, corners.map(|c| *c), crossing.weights);
            if mesh.texture.is_hole(&canvas, &point) {
                return None;
            }
        }
        Some(crossing.t)
    }

    /// The nearest surface on a ray.
    pub(crate) fn nearest(&self, ray: &PathRay) -> Option<Hit> {
        let hierarchy = self.hierarchy.as_ref()?;
        let (unit_ray, parameter) = self.enter(ray)?;
        let aim = Aim::new(ray);
        let (mut nearest, mut found) = (f64::INFINITY, None);
        hierarchy.ray_traverse(unit_ray, &mut RayHit::none(), |_, slot| {
            match self.first_hit(slot, ray, &aim, nearest) {
                Some(t) => {
                    (nearest, found) = (t, Some(slot));
                    parameter(t)
                }
                None => f32::INFINITY,
            }
        });
        found.map(|slot| Hit { t: nearest, slot })
    }

    /// Whether anything that keeps light off lies on a ray, nearer than `farthest` lengths of its direction. Glass
    /// and lamps keep no light off, nor do the holes of a pattern.
    pub(crate) fn is_blocked(&self, ray: &PathRay, farthest: f64) -> bool {
        let Some(hierarchy) = &self.hierarchy else { return false };
        let Some((mut unit_ray, parameter)) = self.enter(ray) else { return false };
        unit_ray.tmax = unit_ray.tmax.min(parameter(farthest));
        let aim = Aim::new(ray);
        let blocks =
            |slot: usize| self.blocks_light(slot) && self.first_hit(slot, ray, &aim, farthest).is_some();
        // Any number below the end of the ray ends the search.
        !hierarchy.ray_traverse_miss(unit_ray, |_, slot| if blocks(slot) { f32::MIN } else { f32::INFINITY })
    }

    #[inline(always)]
    fn blocks_light(&self, slot: usize) -> bool {
        match self.slots[slot].owner {
            owner if owner & Slot::BODY != 0 => self.bodies[(owner ^ Slot::BODY) as usize].blocks_light(),
            owner => self.meshes[owner as usize].blocks_light(),
        }
    }

    /// What is at a hit.
    pub(crate) fn met(&self, ray: &PathRay, hit: Hit) -> Met<'_> {
        let Slot { corners, owner } = self.slots[hit.slot];
        if owner & Slot::BODY != 0 {
            return self.met_body(&self.bodies[(owner ^ Slot::BODY) as usize], ray, hit.t);
        }
        let mesh = &self.meshes[owner as usize];
        let places = corners.map(|index| self.vertices[index as usize]);
        let crossing = Aim::new(ray).crossing([&places[0], &places[1], &places[2]]);
        let weights = crossing.expect("what was hit is crossed").weights;
        let (point, canvas) = mesh.point(corners, places, weights);
        let to_local = mesh.to_local();
        let outward = to_local.transpose() * point.normal;
        Met::Surface(Surface {
            position: places[0] * weights[0] + places[1] * weights[1] + places[2] * weights[2],
            normal: if outward.dot(ray.direction) > 0.0 { -outward } else { outward },
            point,
            canvas,
            texture: &mesh.texture,
            to_local,
            is_thin: mesh.is_open(),
            backwards: -ray.direction.normalize(),
            magnitude: self.radius,
        })
    }

    fn met_body<'a>(&self, body: &'a Body, ray: &PathRay, t: f64) -> Met<'a> {
        let texture = match &body.skin {
            Skin::Texture(texture) => texture,
            Skin::Lamp(index) => return Met::Lamp(*index),
        };
        let point = body.point(ray, t);
        let outward = body.to_world * point.normal;
        // From inside a body its surface is seen from behind; a flat plate has no inside.
        let normal = if outward.dot(ray.direction) > 0.0 { -outward } else { outward };
        Met::Surface(Surface {
            position: body.centre + body.to_world * point.position,
            normal,
            point,
            canvas: body.canvas(),
            texture,
            to_local: body.to_world.transpose(),
            is_thin: body.is_thin(),
            backwards: -ray.direction.normalize(),
            magnitude: body.centre.abs().max_element() + point.position.abs().max_element(),
        })
    }
}

#[cfg(test)]
mod mesh_tests;
#[cfg(test)]
mod surface_tests;
#[cfg(test)]
mod tests;
