//! The light that comes in along a ray.

use super::RayCounts;
use super::beam::{Beam, Way, footprint};
use super::draws::{Draws, Purpose};
use super::optics::Border;
use crate::trace::{Met, PathRay, Surface, Traced};
use crate::{Finish, Occlusion};
use glam::Vec3;

/// A ray is thrown back and bent at most so many times; what would come after that is dark.
const MOST_BOUNCES: u32 = 8;
/// Rays that would add less than this share of what they bring are not followed.
const FAINTEST: f32 = 0.01;
/// Lamps farther away than this from a point shed light on it, metres: nearer, the square of the distance means
/// nothing.
const NEAREST_LAMP: f64 = 1e-6;
/// Shadow rays end this share of their length before the lamp: what holds a lamp keeps none of its light off.
const BEFORE_LAMP: f64 = 1e-6;

/// A ray's place among those that follow one camera ray.
#[derive(Debug, Clone, Copy)]
struct Descent {
    bounces: u32,
    /// Share of its light that reaches the camera.
    weight: f32,
}

/// The light that comes in along a camera ray, linear; not clipped.
pub(super) fn light(scene: &Traced, beam: &Beam, draws: Draws, counts: &mut RayCounts) -> Vec3 {
    Shader { scene, counts }.light(beam, draws, Descent { bounces: 0, weight: 1.0 })
}

/// What glass does at a hit.
struct Glass {
    /// Share of the light that is thrown back.
    back: f32,
    /// How the rest goes on.
    way: Way,
    /// Whether the camera's side of the surface is the inside.
    leaves: bool,
}

impl Glass {
    fn new(beam: &Beam, surface: &Surface<'_>, index: f64) -> Self {
        let direction = beam.ray.direction.normalize();
        let cosine = (-direction.dot(surface.normal)).clamp(0.0, 1.0);
        if surface.is_thin {
            let border = Border { ratio: index.recip(), cosine };
            return Self { back: border.pane_reflectance() as f32, way: Way::Straight, leaves: false };
        }
        let leaves = surface.is_from_inside(direction);
        let border = Border { ratio: if leaves { index } else { index.recip() }, cosine };
        Self { back: border.reflectance() as f32, way: Way::Refracted(border), leaves }
    }
}

struct Shader<'a> {
    scene: &'a Traced,
    counts: &'a mut RayCounts,
}

impl Shader<'_> {
    fn light(&mut self, beam: &Beam, draws: Draws, descent: Descent) -> Vec3 {
        let scene = self.scene;
        let Some(hit) = scene.nearest(&beam.ray) else { return scene.sky.background(beam.ray.direction) };
        let surface = match scene.met(&beam.ray, hit) {
            Met::Surface(surface) => surface,
            Met::Lamp(index) => return scene.lamps[index].seen,
        };
        let spread = beam.spread(hit.t, surface.normal);
        let footprint = footprint(&surface, spread);
        let colour = surface.texture.reflectance(&surface.canvas, &surface.point, &footprint);
        match surface.texture.finish() {
            Finish::Matte => colour * self.received(&surface, draws),
            Finish::Baked => colour,
            Finish::Mirror => {
                let thrown = beam.leaving(&surface, spread, Way::Reflected);
                let share = colour.max_element();
                colour * self.follow(thrown, share, draws.next(0), descent, |c| &mut c.mirror)
            }
            Finish::Glass { index } => {
                let glass = Glass::new(beam, &surface, index);
                let back = beam.leaving(&surface, spread, Way::Reflected);
                let back = self.follow(back, glass.back, draws.next(0), descent, |c| &mut c.reflection);
                let rest = 1.0 - glass.back;
                // The colour counts once for each pass: where the light comes in.
                let tint = if glass.leaves { Vec3::splat(rest) } else { colour * rest };
                let through = beam.leaving(&surface, spread, glass.way);
                let share = tint.max_element();
                let through = self.follow(through, share, draws.next(1), descent, |c| &mut c.refraction);
                back * glass.back + through * tint
            }
        }
    }

    /// The light along a ray that follows, before its share is taken.
    fn follow(
        &mut self,
        beam: Option<Beam>,
        share: f32,
        draws: Draws,
        descent: Descent,
        kind: impl Fn(&mut RayCounts) -> &mut u64,
    ) -> Vec3 {
        let next = Descent { bounces: descent.bounces + 1, weight: descent.weight * share };
        match beam {
            Some(beam) if next.bounces <= MOST_BOUNCES && next.weight >= FAINTEST => {
                *kind(self.counts) += 1;
                self.light(&beam, draws, next)
            }
            _ => Vec3::ZERO,
        }
    }

    /// What a white matte surface shows of the light that it receives.
    fn received(&mut self, surface: &Surface<'_>, draws: Draws) -> Vec3 {
        let mut sum = self.skylight(surface, draws) + self.sunlight(surface, draws);
        for index in 0..self.scene.lamps.len() {
            sum += self.lamplight(surface, index, draws);
        }
        sum
    }

    fn skylight(&mut self, surface: &Surface<'_>, draws: Draws) -> Vec3 {
        let ambient = self.scene.sky.ambient(surface.normal);
        match self.scene.sky.occlusion {
            None => ambient,
            Some(occlusion) => ambient * self.openness(surface, occlusion, draws),
        }
    }

    /// Share of the sky's light that nothing close by keeps off.
    fn openness(&mut self, surface: &Surface<'_>, Occlusion { reach, rays }: Occlusion, draws: Draws) -> f32 {
        let (right, up) = surface.normal.any_orthonormal_pair();
        let origin = surface.departure(surface.normal);
        self.counts.occlusion += u64::from(rays);
        let free = draws.points(Purpose::Occlusion, rays).filter(|within| {
            // Evenly on the disc is cosine-weighted on the hemisphere above it (Malley).
            let place = crate::trace::on_disc(*within);
            let height = (1.0 - within.y).max(0.0).sqrt();
            let direction = right * place.x + up * place.y + surface.normal * height;
            !self.scene.is_blocked(&PathRay { origin, direction }, reach)
        });
        free.count() as f32 / rays as f32
    }

    fn sunlight(&mut self, surface: &Surface<'_>, draws: Draws) -> Vec3 {
        let Some(sun) = &self.scene.sun else { return Vec3::ZERO };
        let direction = match &sun.disc {
            None => sun.direction,
            Some(disc) => disc.towards(sun.direction, draws.point(Purpose::Sun)),
        };
        let cosine = surface.normal.dot(direction);
        if cosine <= 0.0 {
            return Vec3::ZERO;
        }
        self.counts.shadow += 1;
        let towards = PathRay { origin: surface.departure(direction), direction };
        if self.scene.is_blocked(&towards, f64::INFINITY) { Vec3::ZERO } else { sun.radiance * cosine as f32 }
    }

    fn lamplight(&mut self, surface: &Surface<'_>, index: usize, draws: Draws) -> Vec3 {
        let lamp = &self.scene.lamps[index];
        if lamp.strength == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let within =
            if lamp.is_point() { glam::DVec2::ZERO } else { draws.point(Purpose::Lamp(index as u32)) };
        let towards = self.scene.relative(lamp.place(within)) - surface.position;
        let distance = towards.length();
        let (cosine, lamp_cosine) = (surface.normal.dot(towards), -lamp.front.dot(towards));
        if !(cosine > 0.0 && lamp_cosine > 0.0 && distance > NEAREST_LAMP) {
            return Vec3::ZERO;
        }
        self.counts.lamp_shadow += 1;
        let origin = surface.departure(towards);
        let ray = PathRay { origin, direction: towards };
        if self.scene.is_blocked(&ray, 1.0 - BEFORE_LAMP) {
            return Vec3::ZERO;
        }
        // Both cosines still have the distance in them.
        lamp.strength * (cosine * lamp_cosine / distance.powi(4)) as f32
    }
}
