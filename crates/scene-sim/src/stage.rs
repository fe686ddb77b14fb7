//! Shorthand for building scenes in code.

use crate::{Finish, Material, Pattern, Primitive, Rgb, Shape};
use glam::DVec3;

pub(crate) const LIGHT_WOOD: Rgb = [0.80, 0.62, 0.42];
pub(crate) const DARK_WOOD: Rgb = [0.50, 0.32, 0.18];

pub(crate) const fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

pub(crate) fn plain(colour: Rgb) -> Pattern {
    Pattern::Plain { colour }
}

pub(crate) fn wood(plank: f64) -> Pattern {
    Pattern::Wood { light: LIGHT_WOOD, dark: DARK_WOOD, plank }
}

pub(crate) fn noise(dark: Rgb, light: Rgb, scale: f64, octaves: u32) -> Pattern {
    Pattern::Noise { dark, light, scale, octaves }
}

pub(crate) fn print(paper: Rgb, accent: Rgb, line: f64) -> Pattern {
    Pattern::Print { paper, ink: [0.13, 0.13, 0.16], accent, line }
}

/// Collects primitives; each gets a seed of its own from its position in the list.
#[derive(Default)]
pub(crate) struct Stage(pub(crate) Vec<Primitive>);

impl Stage {
    pub(crate) fn put(
        &mut self,
        name: &str,
        shape: Shape,
        centre: DVec3,
        pattern: Pattern,
    ) -> &mut Primitive {
        let material = Material { pattern, mottle: 0.0, seed: self.0.len() as u32, finish: Finish::Matte };
        self.0.push(Primitive { name: name.into(), shape, centre, rotation: DVec3::ZERO, material });
        let last = self.0.len() - 1;
        &mut self.0[last]
    }

    /// A box that stands on its base, turned about the vertical by `turn` degrees.
    pub(crate) fn stand(
        &mut self,
        name: &str,
        size: DVec3,
        base: DVec3,
        turn: f64,
        pattern: Pattern,
    ) -> &mut Primitive {
        let primitive = self.put(name, Shape::Box { size }, base + v(0.0, 0.0, 0.5 * size.z), pattern);
        primitive.rotation.z = turn;
        primitive
    }

    /// A wooden table or bench whose legs have their grain upright.
    pub(crate) fn table(&mut self, name: &str, base: DVec3, size: DVec3, leg: f64, turn: f64, plank: f64) {
        let thickness = 0.6 * leg;
        let top = base + v(0.0, 0.0, size.z - thickness);
        self.stand(&format!("{name} top"), v(size.x, size.y, thickness), top, turn, wood(plank));
        let (sine, cosine) = turn.to_radians().sin_cos();
        let length = size.z - thickness;
        for (i, (sx, sy)) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].into_iter().enumerate() {
            let (x, y) = (sx * (0.5 * size.x - leg), sy * (0.5 * size.y - leg));
            let foot = base + v(x * cosine - y * sine, x * sine + y * cosine, 0.5 * length);
            // The box lies along x, where the grain runs, and is then set upright.
            let shape = Shape::Box { size: v(length, leg, leg) };
            self.put(&format!("{name} leg {i}"), shape, foot, wood(2.0 * leg)).rotation = v(0.0, 90.0, turn);
        }
    }
}
