//! A row of houses across a street; the camera walks along the other pavement.

use crate::Trajectory;
use crate::generate::Plan;
use crate::generate::form::Form;
use crate::generate::palette::{BLACK, STEEL};
use crate::generate::plants::LEAVES;
use crate::generate::set::{Frame, Set};
use crate::generate::sun::daylight;
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{noise, plain, v};
use glam::DVec3;

/// Depth of the pavement before the houses and of the street, metres.
const PAVEMENT: f64 = 2.6;
const STREET: f64 = 6.0;
const KERB: f64 = 0.15;

impl Set {
    fn street(&mut self) {
        let world = Frame::new(DVec3::ZERO, 0.0);
        let long = 120.0;
        let asphalt = noise([0.24, 0.24, 0.25], [0.38, 0.38, 0.38], 0.5, 8);
        self.block(&world, "street", v(long, 60.0, 0.5), v(0.0, -8.0, -0.64), asphalt).material.mottle = 0.3;
        let paving = match self.random.count(0, 2) {
            0 => crate::Pattern::Checker { colours: [[0.62, 0.61, 0.58], [0.56, 0.55, 0.53]], cell: 0.5 },
            1 => crate::Pattern::Brick {
                brick: [0.55, 0.48, 0.44],
                mortar: [0.42, 0.40, 0.38],
                length: 0.22,
                height: 0.11,
                joint: 0.008,
            },
            _ => crate::Pattern::Brick {
                brick: [0.60, 0.59, 0.57],
                mortar: [0.40, 0.39, 0.38],
                length: 0.8,
                height: 0.5,
                joint: 0.012,
            },
        };
        let kerb = noise([0.50, 0.49, 0.47], [0.68, 0.67, 0.64], 0.1, 4);
        // The near one ends at the houses, the far one behind the camera.
        for (from, to, name) in
            [(-PAVEMENT, 0.0, "pavement"), (-PAVEMENT - STREET - 4.0, -PAVEMENT - STREET, "other pavement")]
        {
            let span = if to < 0.0 { [from, to - KERB] } else { [from + KERB, to] };
            let place = v(0.0, 0.5 * (span[0] + span[1]), -0.139);
            self.block(&world, name, v(long, span[1] - span[0], 0.139), place, paving);
            let edge = if to < 0.0 { to - 0.5 * KERB } else { from + 0.5 * KERB };
            self.block(&world, "kerb", v(long, KERB, 0.142), v(0.0, edge, -0.139), kerb);
        }
        let (mut x, paint) = (-24.0, plain([0.86, 0.86, 0.84]));
        while x < 24.0 {
            let place = v(x, -PAVEMENT - 0.5 * STREET, -0.14);
            self.block(&world, "lane mark", v(1.6, 0.12, 0.002), place, paint);
            x += 4.0;
        }
    }

    fn street_lamp(&mut self, frame: &Frame) {
        let iron = plain(self.random.pick(&[BLACK, [0.22, 0.28, 0.26], [0.45, 0.46, 0.47]]));
        self.column(frame, "foot of the street lamp", 0.12, 0.5, DVec3::ZERO, iron);
        let top = v(0.0, 0.0, 4.6);
        self.rod(frame, "post of the street lamp", 0.05, [v(0.0, 0.0, 0.45), top], iron);
        let arm = top - v(0.0, 1.1, -0.25);
        self.rod(frame, "arm of the street lamp", 0.03, [top, arm], iron);
        let shell = [(0.05, 0.16), (0.2, 0.0), (0.18, 0.0), (0.04, 0.14)];
        self.mesh(
            frame,
            "head of the street lamp",
            Form::lathe(&shell, 24),
            arm - v(0.0, 0.0, 0.13),
            DVec3::ZERO,
            iron,
        );
    }

    /// A car that stands along x.
    pub(crate) fn car(&mut self, frame: &Frame) {
        let paint = plain(self.random.strong());
        let (rubber, glass) = (plain([0.08, 0.08, 0.08]), plain([0.16, 0.19, 0.22]));
        let (long, wide) = (self.random.within(3.7, 4.4), 1.68);
        let body = Form::cushion(v(long, wide, 0.62), 0.28);
        self.mesh(frame, "car", body, v(0.0, 0.0, 0.26), DVec3::ZERO, paint);
        let cabin = Form::cushion(v(0.58 * long, wide - 0.16, 0.76), 0.45);
        self.mesh(frame, "windows of the car", cabin, v(0.06 * long, 0.0, 0.6), DVec3::ZERO, glass);
        let roof = Form::cushion(v(0.42 * long, wide - 0.3, 0.1), 0.4);
        self.mesh(frame, "roof of the car", roof, v(0.06 * long, 0.0, 1.29), DVec3::ZERO, paint);
        for (x, y) in [(-0.31, -1.0), (0.31, -1.0), (-0.31, 1.0), (0.31, 1.0)] {
            let place = v(x * long, y * (0.5 * wide - 0.1), 0.31);
            let shape = |radius, height| crate::Shape::Cylinder { radius, height };
            self.put(frame, "wheel", shape(0.31, 0.22), place, v(90.0, 0.0, 0.0), rubber);
            self.put(frame, "hub", shape(0.18, 0.235), place, v(90.0, 0.0, 0.0), plain(STEEL));
        }
        for (x, colour) in [(-0.492, [0.95, 0.93, 0.86]), (0.492, [0.66, 0.10, 0.08])] {
            for side in [-1.0, 1.0] {
                let place = v(x * long, side * 0.6, 0.5);
                self.block(frame, "light of the car", v(0.06, 0.28, 0.12), place, plain(colour));
            }
        }
    }

    fn bin(&mut self, frame: &Frame) {
        let colour = self.random.pick(&[[0.16, 0.30, 0.22], [0.24, 0.25, 0.27], [0.20, 0.26, 0.40]]);
        self.column(frame, "bin", 0.21, 0.75, DVec3::ZERO, plain(colour));
        self.column(frame, "lid of the bin", 0.225, 0.06, v(0.0, 0.0, 0.75), plain(colour.map(|c| 0.6 * c)));
    }

    pub(crate) fn bench(&mut self, frame: &Frame, wide: f64) {
        let (wood, iron) = (self.random.timber(0.11), plain([0.16, 0.17, 0.17]));
        for side in [-1.0, 1.0] {
            let x = side * (0.5 * wide - 0.15);
            for y in [-0.12, -0.48] {
                self.block(frame, "leg of the bench", v(0.05, 0.05, 0.41), v(x, y, 0.0), iron);
            }
            self.block(frame, "beam of the bench", v(0.05, 0.5, 0.03), v(x, -0.3, 0.41), iron);
            let back = [v(x, -0.07, 0.42), v(x, 0.06, 0.85)];
            self.rod(frame, "arm of the bench", 0.02, back, iron);
        }
        for k in 0..4 {
            let place = v(0.0, -0.12 - 0.12 * f64::from(k), 0.44);
            self.block(frame, "slat of the bench", v(wide, 0.1, 0.03), place, wood);
        }
        for k in 0..3 {
            let (z, y) = (0.53 + 0.13 * f64::from(k), -0.055 + 0.04 * f64::from(k));
            let shape = crate::Shape::Box { size: v(wide, 0.025, 0.1) };
            self.put(frame, "slat of the bench", shape, v(0.0, y, z), v(-16.0, 0.0, 0.0), wood);
        }
    }

    fn along_the_kerb(&mut self, half: f64) {
        let mut x = -half + self.random.within(0.0, 3.0);
        let world = Frame::new(DVec3::ZERO, 0.0);
        let mut thing = self.random.count(0, 5);
        while x < half {
            let edge = world.at(v(x, 0.5 - PAVEMENT, 0.0), 0.0);
            match thing % 6 {
                0 | 3 => {
                    let grate = plain([0.20, 0.17, 0.15]);
                    self.block(&edge, "tree pit", v(0.9, 0.6, 0.003), DVec3::ZERO, grate);
                    let tall = self.random.within(4.2, 6.2);
                    self.tree(&edge.at(v(0.0, 0.0, 0.0), 0.0), "tree", tall, LEAVES);
                }
                1 => self.street_lamp(&edge),
                2 => {
                    let wide = self.random.within(1.4, 1.9);
                    self.bench(&edge.at(v(0.0, 0.1, 0.0), 180.0), wide);
                    self.bin(&edge.at(v(1.5, -0.1, 0.0), 0.0));
                }
                4 => {
                    for k in 0..4 {
                        let place = v(1.1 * (f64::from(k) - 1.5), -0.2, 0.0);
                        self.column(&edge, "bollard", 0.06, 0.8, place, plain([0.2, 0.21, 0.22]));
                        self.ball(
                            &edge,
                            "head of the bollard",
                            0.07,
                            place + v(0.0, 0.0, 0.83),
                            plain(STEEL),
                        );
                    }
                }
                _ => {
                    let turn = if self.random.chance(0.5) { 180.0 } else { 0.0 };
                    self.car(&world.at(v(x, -PAVEMENT - 1.05, -0.14), turn));
                }
            }
            thing += self.random.count(1, 5);
            x += self.random.within(3.4, 6.5);
        }
    }
}

pub(crate) fn facade(set: &mut Set) -> Plan {
    set.street();
    let glass = set.random.chance(0.4);
    let mut x = -set.random.within(15.0, 19.0);
    let half = -x;
    while x < half {
        let (wide, storeys) = (set.random.within(6.0, 11.0), set.random.count(2, 4));
        let style = set.style(glass);
        set.house(&Frame::new(v(x + 0.5 * wide, 0.0, 0.0), 0.0), wide - 0.02, storeys, &style);
        x += wide;
    }
    set.along_the_kerb(11.0);
    let (sky, sun) = daylight(&mut set.random, v(0.0, -1.0, 0.0));
    let draw = |random: &mut Random| {
        let side = if random.chance(0.5) { 1.0 } else { -1.0 };
        let (y, z) = (-random.within(9.3, 11.5), random.within(1.45, 1.85));
        let (reach, lead) = (random.within(4.0, 8.0), random.within(-3.0, 3.0));
        let look = random.within(2.6, 3.6);
        let stray = random.within(-0.6, 0.6);
        let places = [-1.0, -0.4, 0.4, 1.0].map(|k| v(side * k * reach, y + stray * k * k, z));
        let targets = [-1.0, -0.4, 0.4, 1.0].map(|k| v(side * k * (reach + lead) * 0.8, 0.0, look));
        by_hand(random, Trajectory::Through { places: places.to_vec(), targets: targets.to_vec() })
    };
    Plan {
        sky,
        sun,
        wish: Wish { field_of_view: [62.0, 74.0], coverage: 0.6, open: 3.0 },
        draw: Box::new(draw),
    }
}
