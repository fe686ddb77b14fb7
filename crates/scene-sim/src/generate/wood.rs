//! A wood from above: crowns beside crowns, glades and a track; the camera flies over it.

use crate::Trajectory;
use crate::generate::Plan;
use crate::generate::form::Form;
use crate::generate::set::{Frame, Set};
use crate::generate::sun::daylight;
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{noise, v};
use crate::{Pattern, Shape};
use glam::{DVec2, DVec3};

/// Half the edge of what is planted, metres.
const HALF: f64 = 20.0;
/// At most so many trees: what is traced grows with their leaves.
const TREES: usize = 120;
/// Lengths of what stands for leaves, metres: tufts of them, for leaves are smaller than the pixels from so far.
const TUFTS: [f64; 2] = [0.15, 0.45];
const TRACK: f64 = 3.4;

impl Set {
    /// Ground under trees, with a track along x of `frame`.
    fn forest_floor(&mut self, frame: &Frame) {
        let world = Frame::new(DVec3::ZERO, 0.0);
        let (dark, light) = self.random.pick(&[
            ([0.20, 0.31, 0.10], [0.47, 0.58, 0.24]),
            ([0.26, 0.22, 0.14], [0.52, 0.50, 0.32]),
            ([0.22, 0.29, 0.12], [0.60, 0.62, 0.34]),
        ]);
        let grass = noise(dark, light, self.random.within(0.8, 2.5), 9);
        self.block(&world, "lawn", v(400.0, 400.0, 0.5), v(0.0, 0.0, -0.5), grass).material.mottle = 0.15;
        let track = self.random.pick(&[
            ([0.50, 0.46, 0.40], [0.74, 0.69, 0.60]),
            ([0.36, 0.36, 0.37], [0.50, 0.50, 0.49]),
            ([0.34, 0.27, 0.20], [0.56, 0.46, 0.35]),
        ]);
        let gravel = noise(track.0, track.1, 0.6, 8);
        self.block(frame, "track", v(120.0, TRACK, 0.02), DVec3::ZERO, gravel);
        let mix = |t: f32| [0, 1, 2].map(|k| dark[k] + (light[k] - dark[k]) * t);
        for side in [-1.0, 1.0] {
            let strip = DVec2::new(2.0 * HALF, 1.2);
            let tall = self.random.within(0.2, 0.5);
            let blades = Form::tufts(&mut self.random, strip, 500, tall, &[mix(0.3), mix(0.7), mix(1.0)]);
            let place = v(0.0, side * (0.5 * TRACK + 0.7), 0.0);
            self.mesh(frame, "grass", blades, place, DVec3::ZERO, Pattern::VertexColours);
        }
    }

    /// What lies about in a glade.
    fn glade(&mut self, middle: DVec2, radius: f64) {
        let count = self.random.count(4, 8);
        for k in 0..count {
            let angle = std::f64::consts::TAU * f64::from(k) / f64::from(count);
            let place = middle + DVec2::from_angle(angle) * (radius * self.random.within(0.2, 0.8));
            let spot = Frame::new(place.extend(0.0), self.random_turn());
            // One bed at most: two that overlap would share a plane.
            if k == 0 {
                let size = DVec2::new(self.random.within(1.0, 2.2), self.random.within(0.8, 1.6));
                self.flower_bed(&spot, size);
                continue;
            }
            match self.random.count(0, 3) {
                0 => self.bench(&spot, 1.6),
                1 => {
                    let size = v(self.random.within(1.0, 2.0), self.random.within(1.0, 1.8), 1.2);
                    self.bush(&spot, size);
                }
                2 => {
                    let stone = noise([0.34, 0.33, 0.31], [0.68, 0.66, 0.62], 0.3, 7);
                    let radius = self.random.within(0.3, 0.8);
                    let turn = v(self.random.within(0.0, 90.0), 0.0, 0.0);
                    let centre = v(0.0, 0.0, 0.6 * radius);
                    self.put(&spot, "boulder", Shape::Sphere { radius }, centre, turn, stone);
                }
                _ => {
                    let bark = noise([0.22, 0.17, 0.12], [0.48, 0.41, 0.33], 0.1, 5);
                    let (radius, long) = (self.random.within(0.12, 0.3), self.random.within(1.5, 3.5));
                    let ends = [v(-0.5 * long, 0.0, 0.9 * radius), v(0.5 * long, 0.0, 0.9 * radius)];
                    self.rod(&spot, "log", radius, ends, bark);
                }
            }
        }
    }
}

pub(crate) fn wood(set: &mut Set) -> Plan {
    let turn = set.random_turn();
    let aside = set.random_shift(6.0);
    let across = DVec2::from_angle((turn + 90.0).to_radians());
    let track = Frame::new((across * aside).extend(0.0), turn);
    set.forest_floor(&track);
    let on_track = |p: DVec2, reach: f64| (p.dot(across) - aside).abs() < 0.5 * TRACK + reach;
    // What is taken: middle and radius.
    let mut taken: Vec<(DVec2, f64)> = Vec::new();
    let place =
        |random: &mut Random, half: f64| DVec2::new(random.within(-half, half), random.within(-half, half));
    for _ in 0..set.random.count(1, 3) {
        let (middle, radius) = (place(&mut set.random, 0.6 * HALF), set.random.within(3.0, 6.5));
        if on_track(middle, radius) || taken.iter().any(|(q, r)| q.distance(middle) < r + radius) {
            continue;
        }
        set.glade(middle, radius);
        taken.push((middle, radius));
    }
    for k in 0..set.random.count(0, 3) {
        let along = 0.5 * HALF * (f64::from(k) - 1.0) + set.random_shift(3.0);
        let spot = track.at(v(along, 0.0, 0.02), 0.0);
        set.car(&spot);
    }
    let height = set.random.within(5.0, 8.0);
    // From crowns that stand alone to ones that reach into each other.
    let room = set.random.within(0.16, 0.28);
    let mut trees = 0;
    for _ in 0..600 {
        let (middle, tall) = (place(&mut set.random, HALF), height * set.random.within(0.7, 1.3));
        let reach = room * tall;
        if trees == TREES {
            break;
        }
        if on_track(middle, 0.7 * reach) || taken.iter().any(|(q, r)| q.distance(middle) < r + reach) {
            continue;
        }
        trees += 1;
        taken.push((middle, reach));
        let spot = Frame::new(middle.extend(0.0), set.random_turn());
        set.tree(&spot, "tree", tall, TUFTS);
    }
    let (sky, sun) = daylight(&mut set.random, v(0.0, -1.0, 0.0));
    Plan {
        sky,
        sun,
        wish: Wish { field_of_view: [50.0, 70.0], coverage: 0.95, open: 4.0 },
        draw: Box::new(flight),
    }
}

/// Around a place of the wood, or straight over it; an upright camera looks ahead and down.
fn flight(random: &mut Random) -> Trajectory {
    let target = v(random.within(-6.0, 6.0), random.within(-6.0, 6.0), 2.0);
    let height = random.within(15.0, 24.0);
    let path = if random.chance(0.5) {
        let (from, span) = (random.within(-180.0, 180.0), random.within(40.0, 90.0));
        Trajectory::Arc { target, radius: random.within(4.0, 16.0), height, from, to: from + span }
    } else {
        let along = DVec2::from_angle(random.within(0.0, std::f64::consts::TAU)) * random.within(6.0, 12.0);
        let ahead = DVec2::from_angle(random.within(0.0, std::f64::consts::TAU)) * random.within(2.0, 10.0);
        let ends = [-1.0, 1.0].map(|sign| target + (sign * along).extend(0.0));
        let places = ends.map(|end| end + (-ahead).extend(height)).to_vec();
        Trajectory::Through { places, targets: ends.to_vec() }
    };
    by_hand(random, path)
}
