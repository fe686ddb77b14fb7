//! Gardens behind a fence; the camera walks around their middle on the open side.

use crate::generate::Plan;
use crate::generate::form::Form;
use crate::generate::palette::{STEEL, WHITE};
use crate::generate::plants::LEAVES;
use crate::generate::set::{Frame, Set};
use crate::generate::sun::daylight;
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{noise, plain, v};
use crate::{Pattern, Shape, Trajectory};
use glam::{DVec2, DVec3};

impl Set {
    /// A fence of planks along x, its middle at the origin.
    fn fence(&mut self, frame: &Frame, long: f64) {
        let wood = self.random.timber(0.3);
        let (tall, plank, gap) =
            (self.random.within(1.2, 1.7), self.random.within(0.09, 0.14), self.random.within(0.012, 0.05));
        let posts = (long / 2.0).ceil() as u32;
        for k in 0..=posts {
            let x = long * (f64::from(k) / f64::from(posts) - 0.5);
            self.post(frame, "fence post", v(0.09, 0.09, tall + 0.1), v(x, 0.07, 0.0), wood);
        }
        for z in [0.25, tall - 0.3] {
            self.block(frame, "fence rail", v(long, 0.04, 0.08), v(0.0, 0.006, z), wood);
        }
        let count = (long / (plank + gap)) as u32;
        let arched = self.random.chance(0.3);
        for k in 0..count {
            let x = (plank + gap) * (f64::from(k) - 0.5 * f64::from(count - 1));
            let arch = if arched { 0.12 * (std::f64::consts::PI * x / 2.0).cos().abs() } else { 0.0 };
            let size = v(plank, 0.02, tall + arch - 0.06 + self.random.within(-0.004, 0.004));
            self.post(frame, "fence plank", size, v(x, -0.0235, 0.06), wood);
        }
    }

    fn garden_wall(&mut self, frame: &Frame, long: f64) {
        let brick = self.random.pick(&[[0.62, 0.36, 0.27], [0.70, 0.60, 0.48], [0.56, 0.34, 0.28]]);
        let pattern =
            Pattern::Brick { brick, mortar: [0.72, 0.70, 0.65], length: 0.25, height: 0.083, joint: 0.012 };
        let tall = self.random.within(1.3, 2.0);
        self.block(frame, "garden wall", v(long, 0.24, tall), DVec3::ZERO, pattern);
        self.block(frame, "coping", v(long, 0.32, 0.06), v(0.0, 0.0, tall), plain([0.68, 0.66, 0.61]));
    }

    fn border(&mut self, frame: &Frame, long: f64) {
        match self.random.count(0, 5) {
            0 | 1 => {
                let size = v(long, self.random.within(0.6, 0.9), self.random.within(1.3, 2.0));
                self.hedge(frame, size);
            }
            2 => self.garden_wall(frame, long),
            _ => self.fence(frame, long),
        }
    }

    fn shed(&mut self, frame: &Frame) {
        let (wide, deep, tall) = (self.random.within(2.0, 2.8), self.random.within(1.8, 2.3), 2.0);
        let wood = self.random.timber(0.16);
        self.block(
            frame,
            "base of the shed",
            v(wide + 0.1, deep + 0.1, 0.08),
            v(0.0, -0.5 * deep, 0.0),
            plain([0.6; 3]),
        );
        self.block(frame, "shed", v(wide, deep, tall), v(0.0, -0.5 * deep, 0.08), wood);
        let trim = plain(if self.random.chance(0.5) { WHITE } else { self.random.strong() });
        let door = if self.random.chance(0.5) { trim } else { self.random.timber(0.2) };
        let x = 0.22 * wide;
        self.post(frame, "door of the shed", v(0.76, 0.04, 1.8), v(x, -deep - 0.02, 0.09), door);
        for side in [-1.0, 1.0] {
            let post = v(0.06, 0.05, 1.82);
            self.block(frame, "door frame of the shed", post, v(x + side * 0.42, -deep - 0.025, 0.081), trim);
        }
        self.block(frame, "door frame of the shed", v(0.9, 0.05, 0.06), v(x, -deep - 0.025, 1.901), trim);
        self.ball(frame, "knob", 0.025, v(x - 0.3, -deep - 0.06, 1.0), plain(STEEL));
        let window = frame.at(v(-0.24 * wide, -deep - 0.03, 1.0), 0.0);
        self.block(
            &window,
            "pane of the shed",
            v(0.6, 0.03, 0.6),
            v(0.0, 0.015, 0.03),
            plain([0.25, 0.30, 0.34]),
        );
        self.sash(&window, DVec2::new(0.66, 0.66), 0.0, trim);
        let roof = Form::roof(v(wide + 0.4, deep + 0.5, self.random.within(0.5, 0.9)), 0.06);
        let rise = roof.vertices.iter().fold(0.0, |most: f64, p| most.max(p.z)) - 0.06;
        let tile = self.random.pick(&[[0.42, 0.24, 0.19], [0.26, 0.27, 0.29], [0.34, 0.38, 0.30]]);
        let tiles = Pattern::Brick {
            brick: tile,
            mortar: tile.map(|c| 0.55 * c),
            length: 0.3,
            height: 0.16,
            joint: 0.015,
        };
        self.mesh(
            frame,
            "roof of the shed",
            roof,
            v(0.0, -0.5 * deep, 2.08 - rise * 0.22),
            DVec3::ZERO,
            tiles,
        );
        for side in [-1.0, 1.0] {
            let gable = Form::gable(deep * 0.98, rise * 0.78);
            self.mesh(
                frame,
                "gable of the shed",
                gable,
                v(side * (0.5 * wide - 0.01), -0.5 * deep, 2.08),
                DVec3::ZERO,
                wood,
            );
        }
    }

    /// Slabs that lead from one place to another over the lawn.
    fn stepping_stones(&mut self, from: DVec2, to: DVec2) {
        let stone = noise([0.50, 0.48, 0.44], [0.74, 0.72, 0.67], 0.25, 6);
        let (way, step) = (to - from, 0.56);
        let count = (way.length() / step) as u32;
        let bend = self.random.within(-0.7, 0.7);
        for k in 0..count {
            let t = (f64::from(k) + 0.5) / f64::from(count);
            let place =
                from + way * t + way.perp().normalize_or_zero() * (bend * (std::f64::consts::PI * t).sin());
            let spot =
                Frame::new(place.extend(0.0), self.random.within(-12.0, 12.0) + way.to_angle().to_degrees());
            let size = v(self.random.within(0.38, 0.46), self.random.within(0.44, 0.56), 0.03);
            self.block(&spot, "stepping stone", size, DVec3::ZERO, stone);
        }
    }

    fn garden_table(&mut self, frame: &Frame) {
        let (wood, seat) = (self.random.timber(0.12), self.random.fabric(0.05));
        let size = v(self.random.within(1.0, 1.5), 0.8, 0.72);
        self.table(frame, "garden table", size, wood);
        for (x, y, turn) in [(-0.28, 0.62, 0.0), (0.28, 0.6, 0.0), (0.0, -0.64, 180.0)] {
            let turn = turn + self.random.within(-14.0, 14.0);
            self.chair(&frame.at(v(x * size.x, y, 0.0), turn), wood, seat);
        }
        let top = frame.at(v(0.0, 0.0, size.z), 0.0);
        self.bowl(&top.at(v(-0.2, 0.1, 0.0), 0.0));
        self.mug(&top.at(v(0.25, -0.15, 0.0), 0.0));
        let tall = self.random.within(0.2, 0.3);
        self.vase(&top.at(v(0.3, 0.15, 0.0), 0.0), tall);
    }

    /// A parasol whose pole stands on the origin.
    fn parasol(&mut self, frame: &Frame) {
        let (tall, reach) = (2.35, 1.3);
        self.column(frame, "foot of the parasol", 0.25, 0.08, DVec3::ZERO, plain([0.5, 0.5, 0.49]));
        self.rod(frame, "pole of the parasol", 0.022, [v(0.0, 0.0, 0.08), v(0.0, 0.0, tall)], plain(WHITE));
        let cloth = self.random.strong();
        let form = Form::lathe(&[(reach, tall - 0.55), (0.002, tall)], 8);
        self.mesh(frame, "parasol", form, DVec3::ZERO, DVec3::ZERO, plain(cloth));
    }

    fn watering_can(&mut self, frame: &Frame) {
        let metal = plain(self.random.pick(&[[0.30, 0.42, 0.34], STEEL, [0.42, 0.55, 0.62]]));
        self.column(frame, "watering can", 0.11, 0.24, DVec3::ZERO, metal);
        self.rod(frame, "spout of the watering can", 0.015, [v(0.09, 0.0, 0.06), v(0.36, 0.0, 0.32)], metal);
        let handle: Vec<DVec3> = (0..9)
            .map(|k| std::f64::consts::PI * f64::from(k) / 8.0)
            .map(|a| v(-0.1 * a.cos(), 0.0, 0.235 + 0.13 * a.sin()))
            .collect();
        self.mesh(
            frame,
            "handle of the watering can",
            Form::tube(&handle, 0.01, 8),
            DVec3::ZERO,
            DVec3::ZERO,
            metal,
        );
    }

    fn bird_bath(&mut self, frame: &Frame) {
        let stone = noise([0.52, 0.51, 0.48], [0.78, 0.76, 0.71], 0.12, 6);
        let profile = [
            (0.24, 0.0),
            (0.22, 0.06),
            (0.09, 0.1),
            (0.07, 0.4),
            (0.09, 0.66),
            (0.2, 0.72),
            (0.36, 0.82),
            (0.36, 0.86),
            (0.3, 0.85),
            (0.12, 0.77),
            (0.001, 0.76),
        ];
        self.mesh(frame, "bird bath", Form::lathe(&profile, 36), DVec3::ZERO, DVec3::ZERO, stone);
        self.column(frame, "water", 0.28, 0.004, v(0.0, 0.0, 0.825), plain([0.42, 0.55, 0.62]));
    }

    fn raised_bed(&mut self, frame: &Frame) {
        let wood = self.random.timber(0.15);
        let (long, wide, tall) = (self.random.within(1.4, 2.0), 0.9, 0.36);
        for side in [-1.0, 1.0] {
            self.block(
                frame,
                "side of the raised bed",
                v(long, 0.04, tall),
                v(0.0, side * 0.5 * wide, 0.0),
                wood,
            );
            let end = v(0.04, wide - 0.042, tall - 0.004);
            self.beam(frame, "end of the raised bed", end, v(side * 0.5 * (long - 0.04), 0.0, 0.0), wood);
        }
        let earth = noise([0.12, 0.09, 0.06], [0.32, 0.24, 0.17], 0.12, 5);
        self.block(
            frame,
            "earth of the raised bed",
            v(long - 0.08, wide - 0.05, tall - 0.06),
            DVec3::ZERO,
            earth,
        );
        for row in 0..3 {
            for k in 0..6 {
                let place = v(long * (f64::from(k) / 6.0 - 0.42), 0.26 * (f64::from(row) - 1.0), tall - 0.06);
                let (green, length) = (self.random.green(), self.random.within(0.14, 0.3));
                let leaves = Form::fronds(&mut self.random, 12, length, 0.07, green);
                self.mesh(frame, "vegetable", leaves, place, DVec3::ZERO, Pattern::VertexColours);
            }
        }
    }

    fn lawn(&mut self, half: DVec2) {
        let world = Frame::new(DVec3::ZERO, 0.0);
        let (dark, light) = self.random.pick(&[
            ([0.20, 0.31, 0.10], [0.47, 0.58, 0.24]),
            ([0.24, 0.35, 0.13], [0.56, 0.64, 0.30]),
            ([0.22, 0.29, 0.12], [0.60, 0.62, 0.34]),
        ]);
        let grass = noise(dark, light, self.random.within(0.5, 1.2), 9);
        self.block(&world, "lawn", v(90.0, 90.0, 0.5), v(0.0, 0.0, -0.5), grass).material.mottle = 0.15;
        let mix = |t: f32| [0, 1, 2].map(|k| dark[k] + (light[k] - dark[k]) * t);
        let blades = Form::tufts(&mut self.random, 2.0 * half, 1500, 0.09, &[mix(0.3), mix(0.6), mix(0.9)]);
        self.mesh(&world, "grass", blades, DVec3::ZERO, DVec3::ZERO, Pattern::VertexColours);
        let hills = Form::terrain(DVec2::splat(150.0), 48, 9.0, 40.0, self.random.bits());
        let wood = noise([0.16, 0.24, 0.12], [0.44, 0.52, 0.28], 4.0, 7);
        self.mesh(&world, "hills", hills, v(0.0, half.y + 90.0, -1.0), DVec3::ZERO, wood);
    }

    /// The back of a house with a terrace before it, at the back of the garden.
    fn back_of_house(&mut self, frame: &Frame) {
        let style = self.style(false);
        let wide = self.random.within(8.0, 10.0);
        let storeys = self.random.count(1, 2);
        self.house(frame, wide, storeys, &style);
        let tiles = Pattern::Checker { colours: [[0.68, 0.62, 0.55], [0.60, 0.55, 0.50]], cell: 0.4 };
        self.block(frame, "terrace", v(wide - 1.0, 2.4, 0.04), v(0.0, -1.2, 0.0), tiles);
    }
}

pub(crate) fn garden(set: &mut Set) -> Plan {
    let half = DVec2::new(set.random.within(4.6, 6.0), set.random.within(4.0, 5.2));
    set.lawn(half);
    let world = Frame::new(DVec3::ZERO, 0.0);
    let back = world.at(v(0.0, half.y, 0.0), 0.0);
    let housed = set.random.chance(0.3);
    if housed {
        set.back_of_house(&back.at(v(0.0, 0.6, 0.0), 0.0));
    } else {
        set.border(&back, 2.0 * half.x + 0.8);
    }
    for (side, turn) in [(-1.0, 90.0), (1.0, -90.0)] {
        let place = v(side * (half.x + 0.7), 0.4, 0.0);
        set.border(&world.at(place, turn), 2.0 * half.y - 1.6);
    }
    // What is taken: middle and radius.
    let mut taken: Vec<(DVec2, f64)> = Vec::new();
    let shed = if set.random.chance(0.5) { 1.0 } else { -1.0 };
    let door = DVec2::new(shed * (half.x - 1.5), half.y - 2.8);
    if !housed {
        set.shed(&world.at(v(shed * (half.x - 1.3), half.y - 0.45, 0.0), 0.0));
        taken.push((DVec2::new(shed * (half.x - 1.3), half.y - 1.5), 1.9));
        let from = DVec2::new(-shed * set.random.within(0.0, 2.0), -half.y + 0.4);
        set.stepping_stones(from, door);
    }
    for k in 0..2 {
        let x = if k == 0 { -shed } else { shed } * set.random.within(0.55, 0.9) * half.x;
        let y = if k == 0 && !housed { half.y - 1.2 } else { set.random.within(-0.2, 0.2) * half.y };
        let tall = set.random.within(2.8, 4.6);
        let turn = set.random_turn();
        set.tree(&world.at(v(x, y, 0.0), turn), "tree", tall, LEAVES);
        taken.push((DVec2::new(x, y), 0.7));
    }
    let far = half.y - if housed { 2.3 } else { 0.6 };
    let mut wanted = vec![0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 9, 9, 3, 8, 1];
    set.random.shuffle(&mut wanted);
    for kind in wanted {
        let reach = [1.4, 0.75, 0.9, 0.9, 0.55, 1.2, 0.4, 0.9, 0.6, 0.45][kind];
        for _ in 0..12 {
            let p = DVec2::new(
                set.random.within(-half.x + reach, half.x - reach),
                set.random.within(-half.y + 1.2, far - reach),
            );
            if taken.iter().any(|(q, r)| q.distance(p) < r + reach) {
                continue;
            }
            taken.push((p, reach));
            let turn = set.random.within(-25.0, 25.0);
            let spot = world.at(p.extend(0.0), turn);
            match kind {
                0 => {
                    set.garden_table(&spot);
                    if set.random.chance(0.4) {
                        set.parasol(&spot);
                    }
                }
                1 | 8 => {
                    let size = v(
                        set.random.within(0.7, 1.1),
                        set.random.within(0.7, 1.1),
                        set.random.within(0.6, 1.2),
                    );
                    set.bush(&spot, size);
                }
                2 => set.bench(&spot, 1.5),
                3 => {
                    let size = DVec2::new(set.random.within(1.0, 1.6), set.random.within(0.7, 1.0));
                    set.flower_bed(&spot, size);
                }
                4 => set.bird_bath(&spot),
                5 => set.raised_bed(&spot),
                6 => set.watering_can(&spot),
                7 => {
                    for k in 0..3 {
                        let place = v(0.45 * (f64::from(k) - 1.0), set.random.within(-0.2, 0.2), 0.0);
                        let tall = set.random.within(0.4, 0.9);
                        set.potted(&spot.at(place, 0.0), tall);
                    }
                }
                _ => {
                    let ball = Shape::Sphere { radius: 0.14 };
                    let colours = [WHITE, set.random.strong()];
                    let pattern = Pattern::Checker { colours, cell: 0.07 };
                    let turn = v(set.random.within(0.0, 90.0), set.random.within(0.0, 90.0), 0.0);
                    set.put(&spot, "ball", ball, v(0.0, 0.0, 0.14), turn, pattern);
                }
            }
            break;
        }
    }
    let (sky, sun) = daylight(&mut set.random, v(0.0, -1.0, 0.0));
    let draw = move |random: &mut Random| {
        let (middle, span) = (random.within(-105.0, -75.0), random.within(50.0, 85.0));
        let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
        let target = v(random.within(-0.4, 0.4), random.within(0.4, 1.2), random.within(0.5, 0.9));
        let arc = Trajectory::Arc {
            target,
            radius: random.within(4.8, 6.8),
            height: random.within(0.75, 1.3),
            from: middle - 0.5 * sign * span,
            to: middle + 0.5 * sign * span,
        };
        by_hand(random, arc)
    };
    Plan {
        sky,
        sun,
        wish: Wish { field_of_view: [56.0, 70.0], coverage: 0.6, open: 1.6 },
        draw: Box::new(draw),
    }
}
