//! A scene made ready for rays.
//!
//! The hierarchy (obvhs, f32) only decides which shapes a ray is tested against; the tests themselves are in
//! f64. The hierarchy lives in a frame of its own, in which the scene is the unit ball around the origin:
//! there the rounding of every f32 number has one bound, whatever the scene's place and scale, and the boxes
//! are grown by more than that bound.

use crate::check::check;
use crate::shape::SurfacePoint;
use crate::texture::{Texture, linear};
use crate::{Result, Scene, Shape, Sky};
use glam::{DMat3, DQuat, DVec3, EulerRot, Vec3, Vec3A};
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

/// Parallel light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SunLight {
    /// Towards the sun, unit length.
    pub(crate) direction: DVec3,
    /// What a white surface that faces the sun reflects.
    pub(crate) radiance: Vec3,
}

/// The background and its light in linear units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SkyLight {
    zenith: Vec3,
    horizon: Vec3,
    ground: Vec3,
    light: f32,
}

/// A shape in its place.
struct Body {
    shape: Shape,
    texture: Texture,
    /// Relative to the middle of the scene.
    centre: DVec3,
    to_world: DMat3,
    to_local: DMat3,
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

/// What shading needs of a hit.
pub(crate) struct Surface<'a> {
    /// Relative to the middle of the scene.
    pub(crate) position: DVec3,
    /// Towards the side that the ray came from, unit length.
    pub(crate) normal: DVec3,
    pub(crate) point: SurfacePoint,
    pub(crate) shape: &'a Shape,
    pub(crate) texture: &'a Texture,
    /// World to shape axes.
    pub(crate) to_local: DMat3,
    /// Largest coordinate that went into the position, metres: what its rounding is proportional to.
    magnitude: f64,
}

impl Surface<'_> {
    /// Where a ray that leaves the surface may start without meeting the surface itself.
    pub(crate) fn departure(&self) -> DVec3 {
        self.position + self.normal * (OFFSET_ULPS * f64::EPSILON * self.magnitude)
    }
}

/// A box of the hierarchy.
struct Bounds(Aabb);

impl Boundable for Bounds {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl SkyLight {
    fn new(sky: &Sky) -> Self {
        let Sky { zenith, horizon, ground, light, .. } = *sky;
        Self { zenith: linear(zenith), horizon: linear(horizon), ground: linear(ground), light }
    }

    /// The background in a direction of any length.
    pub(crate) fn background(&self, direction: DVec3) -> Vec3 {
        let up = direction.z / direction.length();
        if up < 0.0 { self.ground } else { self.horizon.lerp(self.zenith, up.sqrt() as f32) }
    }

    /// What a white surface with this normal reflects of the light from all sides.
    pub(crate) fn ambient(&self, normal: DVec3) -> Vec3 {
        let above = (self.zenith + self.horizon) * 0.5;
        self.ground.lerp(above, (0.5 + 0.5 * normal.z) as f32) * self.light
    }
}

impl Body {
    /// Half the extents of its box along the world's axes.
    fn reach(&self) -> DVec3 {
        let half = self.shape.half();
        if let Shape::Sphere { .. } = self.shape {
            return half;
        }
        let m = self.to_world;
        m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z
    }

    #[inline]
    fn local(&self, ray: &PathRay) -> (DVec3, DVec3) {
        (self.to_local * (ray.origin - self.centre), self.to_local * ray.direction)
    }

    #[inline]
    /// The first crossing of its surface after the start of the ray.
    fn first_hit(&self, ray: &PathRay) -> Option<f64> {
        let (origin, direction) = self.local(ray);
        let (enter, leave) = self.shape.interval(origin, direction)?;
        let t = if enter > 0.0 { enter } else { leave };
        (t > 0.0 && t.is_finite()).then_some(t)
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
            if primitive.shape.is_degenerate() {
                dropped.push(primitive.name.clone());
                continue;
            }
            let [x, y, z] = primitive.rotation.to_array().map(f64::to_radians);
            let to_world = DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, z, y, x));
            bodies.push(Body {
                shape: primitive.shape,
                texture: Texture::new(&primitive.material),
                centre: primitive.centre,
                to_world,
                to_local: to_world.transpose(),
            });
        }
        let sun = scene.sun.as_ref().map(|sun| SunLight {
            direction: sun.towards.normalize(),
            radiance: linear(sun.colour) * sun.strength,
        });
        let mut traced = Self {
            centre: DVec3::ZERO,
            radius: 0.0,
            bodies,
            hierarchy: None,
            sun: sun.filter(|sun| sun.radiance.max_element() > 0.0),
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

    /// Whether anything lies on a ray.
    pub(crate) fn is_blocked(&self, ray: &PathRay) -> bool {
        let Some(hierarchy) = &self.hierarchy else { return false };
        let Some((unit_ray, _)) = self.enter(ray) else { return false };
        let blocks = |body: usize| self.bodies[body].first_hit(ray).is_some();
        !hierarchy.ray_traverse_miss(unit_ray, |_, body| if blocks(body) { 0.0 } else { f32::INFINITY })
    }

    /// The surface at a hit.
    pub(crate) fn surface(&self, ray: &PathRay, hit: Hit) -> Surface<'_> {
        let body = &self.bodies[hit.body];
        let (origin, direction) = body.local(ray);
        let point = body.shape.surface(origin + direction * hit.t, direction);
        let outward = body.to_world * point.normal;
        // From inside a body its surface is seen from behind; a flat plate has no inside.
        let normal = if outward.dot(ray.direction) > 0.0 { -outward } else { outward };
        let magnitude = body.centre.abs().max_element() + point.position.abs().max_element();
        Surface {
            position: body.centre + body.to_world * point.position,
            normal,
            point,
            shape: &body.shape,
            texture: &body.texture,
            to_local: body.to_local,
            magnitude,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Finish, Material, Pattern, Primitive};
    use proptest::prelude::*;

    /// Shapes in cells of a grid, so that many touch and share planes, some far smaller than others.
    fn shapes(scale: f64, offset: DVec3) -> impl Strategy<Value = Scene> {
        let size = prop_oneof![Just(1.0), Just(2.0), Just(4.0), Just(1e-5), Just(0.0)];
        let shape = (prop::array::uniform3(size), 0..4u8).prop_map(move |(size, kind)| {
            let [x, y, z] = size.map(|v| v * scale);
            match kind {
                0 => Shape::Sphere { radius: x },
                1 => Shape::Cylinder { radius: x, height: y },
                2 => Shape::Rectangle { width: x, height: y },
                _ => Shape::Box { size: DVec3::new(x, y, z) },
            }
        });
        let turn = prop::array::uniform3(prop_oneof![Just(0.0), Just(90.0), -180.0..180.0f64]);
        let cell = prop::array::uniform3(-2..3i32);
        let primitive = (shape, turn, cell).prop_map(move |(shape, turn, cell)| Primitive {
            name: String::new(),
            shape,
            centre: offset + DVec3::from(cell.map(f64::from)) * scale,
            rotation: turn.into(),
            material: Material {
                pattern: Pattern::Plain { colour: [0.5; 3] },
                mottle: 0.0,
                seed: 0,
                finish: Finish::Matte,
            },
        });
        let sky = Sky { zenith: [0.5; 3], horizon: [0.5; 3], ground: [0.5; 3], light: 1.0, occlusion: None };
        prop::collection::vec(primitive, 0..30)
            .prop_map(move |primitives| Scene { primitives, ..Scene::under(sky) })
    }

    fn brute_force(scene: &Traced, ray: &PathRay) -> Option<f64> {
        scene.bodies.iter().filter_map(|body| body.first_hit(ray)).reduce(f64::min)
    }

    /// Rays from and to places on, beside and far from the grid, and along its axes (with both signs of zero).
    fn check(scene: &Scene, scale: f64, offset: DVec3, places: &[[f64; 3]], directions: &[[f64; 3]]) {
        let traced = Traced::new(scene).unwrap();
        let places: Vec<DVec3> = places.iter().map(|p| DVec3::from(*p) * scale).collect();
        for &start in &places {
            let aimed = places.iter().map(|place| *place - start);
            for direction in directions.iter().map(|d| DVec3::from(*d)).chain(aimed) {
                if direction.length() < 1e-9 {
                    continue;
                }
                let ray = PathRay { origin: traced.relative(start + offset), direction };
                let expected = brute_force(&traced, &ray);
                assert_eq!(traced.nearest(&ray).map(|hit| hit.t), expected, "{ray:?}");
                assert_eq!(traced.is_blocked(&ray), expected.is_some(), "{ray:?}");
            }
        }
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        let half_cells = (-6..7i32).prop_map(|k| f64::from(k) * 0.5);
        let beside = (half_cells.clone(), -6..0i32).prop_map(|(x, e)| x + 10f64.powi(e));
        prop_oneof![half_cells, beside, -4.0..4.0f64, Just(1e3)]
    }

    fn component() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-1.0), Just(1e-7), Just(-1e-8), -1.0..1.0f64]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        #[test]
        fn the_hierarchy_finds_what_testing_every_shape_finds(
            ((scene, offset), scale) in prop_oneof![Just(1.0), Just(1e-4), Just(1e5)].prop_flat_map(|scale| {
                let offset = prop_oneof![Just(DVec3::ZERO), Just(DVec3::new(1e4, -1e4, 3e3))];
                let scene = offset.prop_flat_map(move |offset| (shapes(scale, offset), Just(offset)));
                (scene, Just(scale))
            }),
            places in prop::collection::vec(prop::array::uniform3(coordinate()), 12),
            directions in prop::collection::vec(prop::array::uniform3(component()), 6),
        ) {
            check(&scene, scale, offset, &places, &directions);
        }
    }
}
