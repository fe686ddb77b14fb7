//! The set that a scene is built on: things in frames that may be turned, each with a seed of its own.

use crate::generate::form::Form;
use crate::random::Random;
use crate::stage::v;
use crate::{Finish, Lamp, Material, Mesh, MeshSource, Pattern, Primitive, Rgb, Shape};
use glam::{DVec2, DVec3};

/// What lies on a surface is this far above it, metres: no two faces share a plane.
pub(crate) const HAIR: f64 = 0.0005;

/// A place with a turn about the vertical. Furniture has its back at y = 0, its front at negative y, x to the right of
/// one who looks at its front, and stands on z = 0.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) origin: DVec3,
    /// Degrees, counter-clockwise as seen from above.
    pub(crate) turn: f64,
}

impl Frame {
    pub(crate) fn new(origin: DVec3, turn: f64) -> Self {
        Self { origin, turn }
    }

    pub(crate) fn point(&self, p: DVec3) -> DVec3 {
        let flat = DVec2::from_angle(self.turn.to_radians()).rotate(p.truncate());
        self.origin + flat.extend(p.z)
    }

    /// A frame in this frame.
    pub(crate) fn at(&self, p: DVec3, turn: f64) -> Self {
        Self { origin: self.point(p), turn: self.turn + turn }
    }
}

/// Collects a scene.
pub(crate) struct Set {
    pub(crate) random: Random,
    pub(crate) primitives: Vec<Primitive>,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) lamps: Vec<Lamp>,
}

impl Set {
    pub(crate) fn new(random: Random) -> Self {
        Self { random, primitives: Vec::new(), meshes: Vec::new(), lamps: Vec::new() }
    }

    fn material(&mut self, pattern: Pattern) -> Material {
        Material { pattern, mottle: 0.0, seed: self.random.bits(), finish: Finish::Matte }
    }

    /// A shape whose middle is at `centre`, turned by `rotation` in its frame.
    pub(crate) fn put(
        &mut self,
        frame: &Frame,
        name: &str,
        shape: Shape,
        centre: DVec3,
        rotation: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        let material = self.material(pattern);
        let rotation = rotation + DVec3::Z * frame.turn;
        self.primitives.push(Primitive {
            name: name.into(),
            shape,
            centre: frame.point(centre),
            rotation,
            material,
        });
        let last = self.primitives.len() - 1;
        &mut self.primitives[last]
    }

    /// A box that stands on `base`, the middle of its underside.
    pub(crate) fn block(
        &mut self,
        frame: &Frame,
        name: &str,
        size: DVec3,
        base: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        self.put(frame, name, Shape::Box { size }, base + v(0.0, 0.0, 0.5 * size.z), DVec3::ZERO, pattern)
    }

    /// As [`Set::block`], with the grain of its wood upright.
    pub(crate) fn post(
        &mut self,
        frame: &Frame,
        name: &str,
        size: DVec3,
        base: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        // The box lies along x, where the grain runs, and is then set upright.
        let shape = Shape::Box { size: v(size.z, size.y, size.x) };
        self.put(frame, name, shape, base + v(0.0, 0.0, 0.5 * size.z), v(0.0, 90.0, 0.0), pattern)
    }

    /// As [`Set::block`], with the grain along y.
    pub(crate) fn beam(
        &mut self,
        frame: &Frame,
        name: &str,
        size: DVec3,
        base: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        let shape = Shape::Box { size: v(size.y, size.x, size.z) };
        self.put(frame, name, shape, base + v(0.0, 0.0, 0.5 * size.z), v(0.0, 0.0, 90.0), pattern)
    }

    /// An upright cylinder that stands on `base`.
    pub(crate) fn column(
        &mut self,
        frame: &Frame,
        name: &str,
        radius: f64,
        height: f64,
        base: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        let shape = Shape::Cylinder { radius, height };
        self.put(frame, name, shape, base + v(0.0, 0.0, 0.5 * height), DVec3::ZERO, pattern)
    }

    pub(crate) fn ball(
        &mut self,
        frame: &Frame,
        name: &str,
        radius: f64,
        centre: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        self.put(frame, name, Shape::Sphere { radius }, centre, DVec3::ZERO, pattern)
    }

    /// A round rod from one point to another.
    pub(crate) fn rod(
        &mut self,
        frame: &Frame,
        name: &str,
        radius: f64,
        ends: [DVec3; 2],
        pattern: Pattern,
    ) -> &mut Primitive {
        let along = ends[1] - ends[0];
        let shape = Shape::Cylinder { radius, height: along.length() };
        let polar = along.truncate().length().atan2(along.z).to_degrees();
        let turn = along.y.atan2(along.x).to_degrees();
        self.put(frame, name, shape, 0.5 * (ends[0] + ends[1]), v(0.0, polar, turn), pattern)
    }

    /// A mesh with the origin of its form at `place`.
    pub(crate) fn mesh(
        &mut self,
        frame: &Frame,
        name: &str,
        form: Form,
        place: DVec3,
        rotation: DVec3,
        pattern: Pattern,
    ) -> &mut Mesh {
        let material = self.material(pattern);
        let Form { vertices, faces, colours } = form;
        self.meshes.push(Mesh {
            name: name.into(),
            source: MeshSource::Inline { vertices, faces, colours },
            centre: frame.point(place),
            rotation: rotation + DVec3::Z * frame.turn,
            scale: 1.0,
            material,
        });
        let last = self.meshes.len() - 1;
        &mut self.meshes[last]
    }

    /// A lamp that shines straight down.
    pub(crate) fn light(
        &mut self,
        frame: &Frame,
        name: &str,
        size: DVec2,
        centre: DVec3,
        colour: Rgb,
        strength: f64,
    ) {
        let rotation = v(180.0, 0.0, frame.turn);
        let (name, centre, strength) = (name.into(), frame.point(centre), strength as f32);
        self.lamps.push(Lamp { name, centre, rotation, size, colour, strength });
    }

    pub(crate) fn random_turn(&mut self) -> f64 {
        self.random.within(0.0, 360.0)
    }

    /// A number in ±`most`.
    pub(crate) fn random_shift(&mut self, most: f64) -> f64 {
        self.random.within(-most, most)
    }
}
