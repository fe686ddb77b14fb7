//! Shapes and lamps in their place.

use super::PathRay;
use crate::shape::{Canvas, SurfacePoint};
use crate::texture::Texture;
use crate::{Finish, Lamp, Primitive, Shape};
use glam::{DMat3, DQuat, DVec3, EulerRot};

/// A shape in its place.
pub(super) struct Body {
    shape: Shape,
    pub(super) skin: Skin,
    /// Relative to the middle of the scene.
    pub(super) centre: DVec3,
    pub(super) to_world: DMat3,
    to_local: DMat3,
}

/// What a body shows.
pub(super) enum Skin {
    /// A material.
    Texture(Texture),
    /// The light of this lamp of the scene.
    Lamp(usize),
}

/// Own axes to the world's, from turns about the world's x, then y, then z axis in degrees.
pub(super) fn turn(rotation: DVec3) -> DMat3 {
    let [x, y, z] = rotation.to_array().map(f64::to_radians);
    DMat3::from_quat(DQuat::from_euler(EulerRot::ZYX, z, y, x))
}

impl Body {
    fn new(shape: Shape, skin: Skin, centre: DVec3, rotation: DVec3) -> Self {
        let to_world = turn(rotation);
        Self { shape, skin, centre, to_world, to_local: to_world.transpose() }
    }

    /// `None` if the primitive has no area.
    pub(super) fn of_primitive(primitive: &Primitive) -> Option<Self> {
        let Primitive { shape, centre, rotation, material, .. } = primitive;
        let skin = || Skin::Texture(Texture::new(material));
        (!shape.is_degenerate()).then(|| Self::new(*shape, skin(), *centre, *rotation))
    }

    /// `None` if the lamp has no area, and so is not seen.
    pub(super) fn of_lamp(index: usize, lamp: &Lamp) -> Option<Self> {
        let shape = Shape::Rectangle { width: lamp.size.x, height: lamp.size.y };
        (lamp.size.min_element() > 0.0)
            .then(|| Self::new(shape, Skin::Lamp(index), lamp.centre, lamp.rotation))
    }

    /// Half the extents of its box along the world's axes.
    pub(super) fn reach(&self) -> DVec3 {
        let half = self.shape.half();
        if let Shape::Sphere { .. } = self.shape {
            return half;
        }
        let m = self.to_world;
        m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z
    }

    /// Whether it keeps light off what is behind it. Glass and lamps do not.
    pub(super) fn blocks_light(&self) -> bool {
        match &self.skin {
            Skin::Texture(texture) => !matches!(texture.finish(), Finish::Glass { .. }),
            Skin::Lamp(_) => false,
        }
    }

    #[inline]
    fn local(&self, ray: &PathRay) -> (DVec3, DVec3) {
        (self.to_local * (ray.origin - self.centre), self.to_local * ray.direction)
    }

    /// The first crossing of its surface after the start of the ray.
    #[inline]
    pub(super) fn first_hit(&self, ray: &PathRay) -> Option<f64> {
        let (origin, direction) = self.local(ray);
        let (enter, leave) = self.shape.interval(origin, direction)?;
        let ahead = |t: &f64| *t > 0.0 && t.is_finite();
        match &self.skin {
            // From behind a lamp is not there.
            Skin::Lamp(_) if direction.z >= 0.0 => None,
            Skin::Texture(texture) if texture.has_holes() => [enter, leave].into_iter().find(|t| {
                let point = || self.shape.surface(origin + direction * *t, direction);
                ahead(t) && !texture.is_hole(&Canvas::Shape(self.shape), &point())
            }),
            _ => [enter, leave].into_iter().find(ahead),
        }
    }

    /// The point that a ray meets at `t`, in the shape's axes.
    pub(super) fn point(&self, ray: &PathRay, t: f64) -> SurfacePoint {
        let (origin, direction) = self.local(ray);
        self.shape.surface(origin + direction * t, direction)
    }

    /// Whether it has no inside.
    pub(super) fn is_thin(&self) -> bool {
        self.shape.half().min_element() == 0.0
    }

    pub(super) fn canvas(&self) -> Canvas {
        Canvas::Shape(self.shape)
    }
}
