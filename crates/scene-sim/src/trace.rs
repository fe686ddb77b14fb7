//! A scene made ready for rays.
//!
//! The hierarchy (obvhs, f32) only decides which shapes a ray is tested against; the tests themselves are in
//! f64. The hierarchy lives in a frame of its own, in which the scene is the unit ball around the origin:
//! there the rounding of every f32 number has one bound, whatever the scene's place and scale, and the boxes
//! are grown by more than that bound.

mod body;
/// The lights, for shading.
mod lights;

use crate::check::check;
use crate::shape::{Canvas, SurfacePoint};
use crate::texture::Texture;
use crate::{Result, Scene};
use body::{Body, Skin};
use glam::{DMat3, DVec3, Vec3A};
use lights::{SkyLight, SunLight};
use obvhs::aabb::Aabb;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh};
use obvhs::ray::{Ray, RayHit};
use obvhs::{Boundable, BvhBuildParams};
use std::time::Duration;

/// How far the boxes of the hierarchy are grown, in radii of the scene: about thirty times the rounding of
/// coordinates, quantised boxes and slab tests in f32 (each a few times 2^-24).
const MARGIN: f64 = 4e-6;
/// How far before its start a ray begins in the hierarchy, in radii: obvhs skips boxes that end within 1e-4
/// of the start.
const RUN_UP: f64 = 1e-3;
/// Shadow rays start this many units of rounding above the surface: the hit point is exact to about eight.
const OFFSET_ULPS: f64 = 64.0;

/// A scene made ready for rays: checked, centred, sorted into a hierarchy.
pub struct Traced {
    /// The middle of the scene in the world: all that follows is relative to it.
    centre: DVec3,
    /// Of the ball around the middle that holds everything; 0 for an empty scene.
    radius: f64,
    bodies: Vec<Body>,
    hierarchy: Option<CwBvh>,
    pub(crate) sun: Option<SunLight>,
    pub(crate) sky: SkyLight,
    dropped: Vec<String>,
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
    body: usize,
}

/// What a ray meets.
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
    /// Largest coordinate that went into the position, metres: what its rounding is proportional to.
    magnitude: f64,
}

impl Surface<'_> {
    /// Where a ray that leaves the surface in this direction, on either of its sides, may start without meeting the
    /// surface itself.
    pub(crate) fn departure(&self, direction: DVec3) -> DVec3 {
        let side = if direction.dot(self.normal) < 0.0 { -1.0 } else { 1.0 };
        self.position + self.normal * (side * OFFSET_ULPS * f64::EPSILON * self.magnitude)
    }
}

/// A box of the hierarchy.
struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Traced {
    /// Checks a scene and makes it ready for rays. Primitives without area are dropped, see
    /// [`Traced::dropped`].
    ///
    /// # Errors
    /// If a number of the description is not finite or out of its range; the error names the primitive and
    /// the field.
    pub fn new(scene: &Scene) -> Result<Self> {
        check(scene)?;
        let (mut bodies, mut dropped) = (Vec::new(), Vec::new());
        for primitive in &scene.primitives {
            match Body::of_primitive(primitive) {
                Some(body) => bodies.push(body),
                None => dropped.push(primitive.name.clone()),
            }
        }
        bodies.extend(scene.lamps.iter().enumerate().filter_map(|(index, lamp)| Body::of_lamp(index, lamp)));
        let mut traced = Self {
            centre: DVec3::ZERO,
            radius: 0.0,
            bodies,
            hierarchy: None,
            sun: scene.sun.as_ref().and_then(SunLight::new),
            sky: SkyLight::new(&scene.sky),
            dropped,
        };
        traced.sort();
        Ok(traced)
    }

    /// Centres the bodies and builds the hierarchy over them.
    fn sort(&mut self) {
        let Some(first) = self.bodies.first() else { return };
        let corners = self.bodies.iter().map(|body| (body.centre - body.reach(), body.centre + body.reach()));
        let start = (first.centre, first.centre);
        let (low, high) = corners.fold(start, |(low, high), (a, b)| (low.min(a), high.max(b)));
        self.centre = 0.5 * (low + high);
        self.radius = 0.5 * (high - low).length();
        for body in &mut self.bodies {
            body.centre -= self.centre;
        }
        let bounds = |body: &Body| {
            let (centre, reach) = (body.centre / self.radius, body.reach() / self.radius + MARGIN);
            Bounds(Aabb::new((centre - reach).as_vec3a(), (centre + reach).as_vec3a()))
        };
        let boxes: Vec<Bounds> = self.bodies.iter().map(bounds).collect();
        let hierarchy = build_cwbvh(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        // In the order of the leaves, so that a ray finds its candidates side by side.
        let mut unsorted: Vec<Option<Body>> = self.bodies.drain(..).map(Some).collect();
        let order = hierarchy.primitive_indices.iter();
        self.bodies = order.filter_map(|&index| unsorted[index as usize].take()).collect();
        assert_eq!(self.bodies.len(), unsorted.len(), "the hierarchy names every body once");
        self.hierarchy = Some(hierarchy);
    }

    /// Names of the primitives that have no area and are not seen, in the order of the scene.
    #[must_use]
    pub fn dropped(&self) -> &[String] {
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

    /// The nearest surface on a ray.
    pub(crate) fn nearest(&self, ray: &PathRay) -> Option<Hit> {
        let hierarchy = self.hierarchy.as_ref()?;
        let (unit_ray, parameter) = self.enter(ray)?;
        let mut nearest: Option<Hit> = None;
        hierarchy.ray_traverse(unit_ray, &mut RayHit::none(), |_, body| {
            match self.bodies[body].first_hit(ray) {
                Some(t) if nearest.is_none_or(|hit| t < hit.t) => {
                    nearest = Some(Hit { t, body });
                    parameter(t)
                }
                _ => f32::INFINITY,
            }
        });
        nearest
    }

    /// Whether anything that keeps light off lies on a ray, nearer than `farthest` lengths of its direction. Glass
    /// and lamps keep no light off, nor do the holes of a pattern.
    pub(crate) fn is_blocked(&self, ray: &PathRay, farthest: f64) -> bool {
        let Some(hierarchy) = &self.hierarchy else { return false };
        let Some((mut unit_ray, parameter)) = self.enter(ray) else { return false };
        unit_ray.tmax = unit_ray.tmax.min(parameter(farthest));
        let blocks = |body: &Body| body.blocks_light() && body.first_hit(ray).is_some_and(|t| t < farthest);
        // Any finite number ends the search.
        let found = |_: &Ray, body: usize| if blocks(&self.bodies[body]) { f32::MIN } else { f32::INFINITY };
        !hierarchy.ray_traverse_miss(unit_ray, found)
    }

    /// What is at a hit.
    pub(crate) fn met(&self, ray: &PathRay, hit: Hit) -> Met<'_> {
        let body = &self.bodies[hit.body];
        let texture = match &body.skin {
            Skin::Texture(texture) => texture,
            Skin::Lamp(index) => return Met::Lamp(*index),
        };
        let point = body.point(ray, hit.t);
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
            magnitude: body.centre.abs().max_element() + point.position.abs().max_element(),
        })
    }
}

#[cfg(test)]
mod tests;
