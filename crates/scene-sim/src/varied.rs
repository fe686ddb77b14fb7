//! Random variants of one kind of scene, for tests and evaluation of stereo: a room open to the sky and to the
//! camera, with things on its floor and on a table.

use crate::random::Random;
use crate::stage::{Stage, noise, plain, print, v, wood};
use crate::trajectory::{Trajectory, lens};
use crate::{Pattern, Result, Scene, Shape, Sky, Sun};
use glam::{DVec2, DVec3};
use gs_scene::Camera;

/// Distance of two things on the floor, and of a thing from a wall, metres.
const GAP: f64 = 0.06;

impl Random {
    /// A pattern for a thing about `size` metres large; one in four is plain.
    fn pattern(&mut self, size: f64) -> Pattern {
        let [light, dark] = self.colours();
        match self.bits() % 8 {
            0 | 1 => plain(light),
            2 => Pattern::Checker { colours: [light, dark], cell: size * self.within(0.08, 0.3) },
            3 => wood(size * self.within(0.2, 0.6)),
            4 | 5 => noise(dark, light, size * self.within(0.2, 0.8), 5),
            _ => print(light, dark, size * self.within(0.05, 0.1)),
        }
    }

    fn wall(&mut self) -> Pattern {
        let [light, dark] = self.colours();
        match self.bits() % 5 {
            0 | 1 => plain(light),
            2 => {
                let (length, height) = (self.within(0.2, 0.4), self.within(0.07, 0.2));
                Pattern::Brick { brick: dark, mortar: light, length, height, joint: 0.012 }
            }
            3 => wood(self.within(0.12, 0.3)),
            _ => noise(dark, light, self.within(0.3, 1.0), 6),
        }
    }

    fn floor(&mut self) -> Pattern {
        let colours = self.colours();
        match self.bits() % 3 {
            0 => Pattern::Checker { colours, cell: self.within(0.2, 0.6) },
            1 => wood(self.within(0.1, 0.25)),
            _ => noise(colours[1], colours[0], self.within(0.4, 1.5), 6),
        }
    }

    /// Puts a box, sphere or cylinder about `size` metres large at `base`, and says how high it is.
    fn thing(&mut self, stage: &mut Stage, name: &str, base: DVec3, size: f64) -> f64 {
        let pattern = self.pattern(size);
        match self.bits() % 4 {
            0 => {
                let radius = 0.5 * size * self.within(0.6, 1.0);
                let centre = base + DVec3::Z * radius;
                let turn = v(self.within(0.0, 360.0), self.within(0.0, 360.0), 0.0);
                stage.put(name, Shape::Sphere { radius }, centre, pattern).rotation = turn;
                2.0 * radius
            }
            1 => {
                let (radius, height) = (0.5 * size * self.within(0.4, 0.8), size * self.within(0.5, 1.5));
                let shape = Shape::Cylinder { radius, height };
                stage.put(name, shape, base + DVec3::Z * (0.5 * height), pattern);
                height
            }
            _ => {
                // The diagonal of the base is at most the size, so that no turn reaches farther.
                let [x, y, z] = [0.7, 0.7, 1.2].map(|most| size * self.within(0.4 * most, most));
                stage.stand(name, v(x, y, z), base, self.within(0.0, 360.0), pattern);
                z
            }
        }
    }
}

/// A random room, about 5 m wide, open to the sky and towards -y: floor, a back wall, side walls or not, a table or
/// not, and ten or more things of all materials, a quarter of them plain. The same seed gives the same room.
#[must_use]
pub fn varied_scene(seed: u64) -> Scene {
    let (mut random, mut stage) = (Random::new(seed, 0), Stage::default());
    let (width, depth, height) = (random.within(4.2, 6.0), random.within(3.2, 5.0), random.within(1.8, 2.8));
    let (back, side) = (0.5 * depth, 0.5 * width);
    let ground = noise([0.24, 0.28, 0.16], [0.52, 0.55, 0.34], 0.9, 6);
    stage.put("ground", Shape::Rectangle { width: 60.0, height: 60.0 }, v(0.0, 0.0, -0.02), ground);
    let floor = Shape::Rectangle { width, height: depth + 3.0 };
    let pattern = random.floor();
    stage.put("floor", floor, v(0.0, -1.5, 0.0), pattern).material.mottle = random.within(0.0, 0.5) as f32;
    let pattern = random.wall();
    stage.stand("back wall", v(width, 0.2, height), v(0.0, back + 0.1, 0.0), 0.0, pattern);
    for (name, sign) in [("left wall", -1.0), ("right wall", 1.0)] {
        if random.chance(0.7) {
            let pattern = random.wall();
            let centre = v(sign * (side + 0.1), 0.0, 0.0);
            stage.stand(name, v(0.2, depth + 0.4, height), centre, 0.0, pattern);
        }
    }
    furnish(&mut random, &mut stage, side, back);
    let towards = v(random.within(-0.8, 0.8), random.within(-0.9, -0.4), random.within(0.6, 1.2));
    let overcast = random.chance(0.2);
    let sky = Sky {
        zenith: [0.36, 0.56, 0.86],
        horizon: [0.84, 0.90, 0.95],
        ground: [0.43, 0.46, 0.29],
        light: if overcast { 1.2 } else { 0.6 },
        occlusion: None,
    };
    let sun = Sun { towards, colour: [1.0, 0.96, 0.9], strength: 0.85, diameter: 0.0 };
    Scene { primitives: stage.0, sun: (!overcast).then_some(sun), ..Scene::under(sky) }
}

/// Puts things on the floor of the room where there is room for them, and on the table if there is one.
fn furnish(random: &mut Random, stage: &mut Stage, side: f64, back: f64) {
    // Circles that are taken: centre and radius.
    let mut taken: Vec<(DVec2, f64)> = Vec::new();
    if random.chance(0.6) {
        let (x, y, turn) = (random.within(-0.6, 0.6), random.within(-0.1, 0.3), random.within(-30.0, 30.0));
        let size = v(random.within(1.0, 1.5), random.within(0.6, 0.8), random.within(0.5, 0.75));
        stage.table("table", v(x, y, 0.0), size, 0.07, turn, random.within(0.1, 0.2));
        taken.push((DVec2::new(x, y), 0.5 * size.truncate().length()));
        let along = DVec2::from_angle(turn.to_radians());
        for (index, place) in [-0.33, 0.0, 0.33].into_iter().enumerate() {
            let p = DVec2::new(x, y) + along * (place * size.x);
            let breadth = random.within(0.15, 0.28);
            random.thing(stage, &format!("thing {index} on the table"), p.extend(size.z), breadth);
        }
    }
    // A place that is taken is given up, so that the number of things varies but the work does not.
    for index in 0..40 {
        let size = random.within(0.25, 0.9);
        let reach = 0.5 * size + GAP;
        let p = DVec2::new(random.within(reach - side, side - reach), random.within(-0.9, back - reach));
        if taken.len() < 12 && taken.iter().all(|(q, r)| p.distance(*q) > r + reach) {
            let top = random.thing(stage, &format!("thing {index}"), p.extend(0.0), size);
            taken.push((p, reach));
            // Only what is surely a level top carries another thing.
            let level = matches!(stage.0.last().map(|last| last.shape), Some(Shape::Box { .. }));
            if level && random.chance(0.4) {
                random.thing(stage, &format!("thing on thing {index}"), p.extend(top), 0.35 * size);
            }
        }
    }
}

/// `count` cameras that look into the room of [`varied_scene`] with the same seed, 5 to 7 degrees apart on an arc.
///
/// # Errors
/// If the size is empty.
pub fn varied_cameras(seed: u64, width: usize, height: usize, count: usize) -> Result<Vec<Camera>> {
    let mut random = Random::new(seed, 1);
    let span = random.within(5.0, 7.0) * count.saturating_sub(1) as f64;
    let middle = random.within(-98.0, -82.0);
    let arc = Trajectory::Arc {
        target: v(random.within(-0.2, 0.2), 0.4, random.within(0.6, 0.9)),
        radius: random.within(3.3, 4.0),
        height: random.within(0.4, 1.0),
        from: middle - 0.5 * span,
        to: middle + 0.5 * span,
    };
    arc.cameras(lens(width, height, random.within(55.0, 65.0)), count)
}
