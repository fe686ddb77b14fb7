//! A ray with its neighbours: how far they lie from it says which part of a surface a sample stands for.
//!
//! Ray differentials after H. Igehy, "Tracing Ray Differentials", 1999.

use super::optics::{Border, reflected};
use crate::Shape;
use crate::shape::{Canvas, Face};
use crate::texture::Footprint;
use crate::trace::{PathRay, Surface};
use glam::DVec3;

/// A ray, and how it differs from those of the samples to its right and below.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beam {
    pub(super) ray: PathRay,
    /// Differences of the origin.
    pub(super) from: [DVec3; 2],
    /// Differences of the direction.
    pub(super) towards: [DVec3; 2],
}

/// How a surface throws rays back or lets them through.
#[derive(Debug, Clone, Copy)]
pub(super) enum Way {
    Reflected,
    Refracted(Border),
    Straight,
}

impl Beam {
    /// How far from a hit the neighbours meet the plane of the surface, world axes, metres.
    pub(super) fn spread(&self, t: f64, normal: DVec3) -> [DVec3; 2] {
        let direction = self.ray.direction;
        let facing = normal.dot(direction);
        // Edge-on the footprint has no end; this bounds it without a visible effect.
        let facing = if facing.abs() < 1e-6 { -1e-6 } else { facing };
        let on_plane = |v: DVec3| v - direction * (normal.dot(v) / facing);
        std::array::from_fn(|i| on_plane(self.towards[i]) * t + on_plane(self.from[i]))
    }

    /// The beam that leaves a surface; `None` for refraction that is total reflection.
    pub(super) fn leaving(&self, surface: &Surface<'_>, spread: [DVec3; 2], way: Way) -> Option<Self> {
        let length = self.ray.direction.length();
        let (direction, normal) = (self.ray.direction / length, surface.normal);
        let cosine = -direction.dot(normal);
        let (leaves, ratio, factor) = match way {
            Way::Reflected => (reflected(direction, normal), 1.0, 2.0 * cosine),
            Way::Straight => (direction, 1.0, 0.0),
            Way::Refracted(border) => {
                let leaves = border.refracted(direction, normal)?;
                (leaves, border.ratio, border.ratio * border.cosine - border.inner_cosine()?)
            }
        };
        // The direction that leaves is ratio * direction + factor * normal: its differences by the product rule.
        let towards = std::array::from_fn(|i| {
            let turned = (self.towards[i] - direction * direction.dot(self.towards[i])) / length;
            let bent = change_of_normal(surface, spread[i]);
            let change = -(turned.dot(normal) + direction.dot(bent));
            let factor_change = match way {
                Way::Reflected => 2.0 * change,
                Way::Straight => return turned,
                Way::Refracted(border) => {
                    let inner = border.inner_cosine().unwrap_or(1.0).max(1e-3);
                    ratio * change * (1.0 - ratio * border.cosine / inner)
                }
            };
            turned * ratio + bent * factor + normal * factor_change
        });
        let ray = PathRay { origin: surface.departure(leaves), direction: leaves };
        Some(Self { ray, from: spread, towards })
    }
}

/// The part of the surface between neighbours, in shape axes.
pub(super) fn footprint(surface: &Surface<'_>, spread: [DVec3; 2]) -> Footprint {
    let [across, down] = spread.map(|v| surface.to_local * v);
    Footprint { across, down }
}

/// How the normal changes from a point of the surface to one beside it.
fn change_of_normal(surface: &Surface<'_>, beside: DVec3) -> DVec3 {
    let (Canvas::Shape(shape), Face::Round) = (&surface.canvas, surface.point.face) else {
        return DVec3::ZERO;
    };
    let local = surface.to_local * beside;
    let change = match *shape {
        Shape::Sphere { radius } => local / radius,
        Shape::Cylinder { radius, .. } => local.with_z(0.0) / radius,
        Shape::Rectangle { .. } | Shape::Box { .. } => return DVec3::ZERO,
    };
    let world = surface.to_local.transpose() * change;
    let outward = surface.to_local.transpose() * surface.point.normal;
    if outward.dot(surface.normal) < 0.0 { -world } else { world }
}
