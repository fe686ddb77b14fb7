//! Small things: what stands on shelves, tables and sills. Each stands on the origin of its frame.

use crate::Pattern;
use crate::generate::form::Form;
use crate::generate::palette::{BLACK, BRASS, EARTH, STEEL, WHITE};
use crate::generate::set::{Frame, HAIR, Set};
use crate::stage::{plain, v};
use glam::{DVec2, DVec3};
use std::f64::consts::PI;

impl Set {
    /// A row of books that fills `width`, side by side from x = 0 on, their spines towards the front.
    pub(crate) fn books(&mut self, frame: &Frame, width: f64, deep: f64, tallest: f64) {
        let mut x = 0.0;
        while x < width - 0.06 {
            let thick = self.random.within(0.016, 0.05);
            let tall = tallest * self.random.within(0.66, 0.97);
            let long = deep * self.random.within(0.72, 0.97);
            let colour = self.random.strong();
            let printed = self.random.chance(0.35);
            let cover = if printed { self.random.printed(thick / 4.5) } else { plain(colour) };
            // The spines are in line.
            let base = v(x + 0.5 * thick, -deep + 0.5 * long, 0.0);
            self.block(frame, "book", v(thick - 0.001, long, tall), base, cover);
            if !printed {
                let light = self.random.pick(&[[0.90, 0.82, 0.55], [0.92, 0.90, 0.86], [0.12, 0.12, 0.14]]);
                let bands = self.random.count(1, 3);
                // Each band keeps to its part of the spine.
                let part = 0.8 * tall / f64::from(bands);
                for band in 0..bands {
                    let high = (part - 0.004).min(self.random.within(0.008, 0.05));
                    let z =
                        0.1 * tall + part * f64::from(band) + self.random.within(0.0, part - 0.002 - high);
                    let size = v(thick - 0.003, 0.0012, high);
                    self.block(frame, "label of a book", size, v(base.x, -deep - 0.0006, z), plain(light));
                }
            }
            x += thick;
        }
    }

    /// Books one on another; says how high the pile is.
    pub(crate) fn pile_of_books(&mut self, frame: &Frame, count: u32, size: f64) -> f64 {
        let mut z = 0.0;
        for index in 0..count {
            let shrink = 1.0 - 0.08 * f64::from(index);
            let thick = self.random.within(0.015, 0.04);
            let extent = v(size * shrink * self.random.within(0.85, 1.0), 0.72 * size * shrink, thick);
            let spot = frame.at(v(0.0, 0.0, z), self.random.within(-14.0, 14.0));
            let cover = if self.random.chance(0.5) {
                self.random.printed(0.012)
            } else {
                plain(self.random.strong())
            };
            // Pages between two covers, a little smaller than they.
            let board = 0.003;
            self.block(&spot, "cover of a book", v(extent.x, extent.y, board), DVec3::ZERO, cover);
            let pages = v(extent.x - 0.008, extent.y - 0.008, thick - 2.0 * board);
            self.block(&spot, "pages of a book", pages, v(0.0, 0.0, board), plain([0.92, 0.89, 0.80]));
            self.block(
                &spot,
                "cover of a book",
                v(extent.x, extent.y, board),
                v(0.0, 0.0, thick - board),
                cover,
            );
            z += thick;
        }
        z
    }

    pub(crate) fn mug(&mut self, frame: &Frame) {
        let (radius, tall) = (self.random.within(0.036, 0.045), self.random.within(0.08, 0.105));
        let glaze =
            if self.random.chance(0.3) { self.random.printed(0.01) } else { plain(self.random.strong()) };
        let inside = radius - 0.004;
        let profile = [
            (0.001, 0.0),
            (radius * 0.9, 0.0),
            (radius, 0.006),
            (radius, tall),
            (inside, tall),
            (inside, 0.01),
            (0.001, 0.01),
        ];
        let turn = self.random.within(0.0, 360.0);
        let spot = frame.at(DVec3::ZERO, turn);
        self.mesh(&spot, "mug", Form::lathe(&profile, 28), DVec3::ZERO, DVec3::ZERO, glaze);
        let handle: Vec<DVec3> = (0..9)
            .map(|k| {
                let (sine, cosine) = (PI * (f64::from(k) / 8.0 - 0.5)).sin_cos();
                v(radius - 0.002 + 0.026 * cosine, 0.0, 0.5 * tall + 0.3 * tall * sine)
            })
            .collect();
        self.mesh(&spot, "handle of the mug", Form::tube(&handle, 0.005, 8), DVec3::ZERO, DVec3::ZERO, glaze);
        self.put_disc(&spot, "coffee", inside - 0.0005, 0.75 * tall, plain([0.20, 0.11, 0.06]));
    }

    fn put_disc(&mut self, frame: &Frame, name: &str, radius: f64, z: f64, pattern: Pattern) {
        self.column(frame, name, radius, 0.002, v(0.0, 0.0, z), pattern);
    }

    /// A vase of a random profile, with twigs in it or without.
    pub(crate) fn vase(&mut self, frame: &Frame, tall: f64) {
        let belly = tall * self.random.within(0.22, 0.4);
        let (foot, neck) = (belly * self.random.within(0.5, 0.8), belly * self.random.within(0.25, 0.7));
        let place = self.random.within(0.3, 0.6);
        let outside: Vec<(f64, f64)> = (0..=14)
            .map(|k| {
                let t = f64::from(k) / 14.0;
                let bulge = (-((t - place) / 0.28).powi(2)).exp();
                let (plain, lip) = (foot + (neck - foot) * t, 0.12 * belly * ((t - 0.85) / 0.15).max(0.0));
                (plain + (belly - plain) * bulge + lip, t * tall)
            })
            .collect();
        let rim = outside[14].0;
        let profile: Vec<(f64, f64)> = [(0.001, 0.0)]
            .into_iter()
            .chain(outside)
            .chain([(rim - 0.004, tall), (neck * 0.7, 0.7 * tall), (0.001, 0.6 * tall)])
            .collect();
        let glaze = if self.random.chance(0.3) {
            let (dark, light) = (self.random.strong(), self.random.paint());
            crate::stage::noise(dark, light, 0.3 * tall, 4)
        } else {
            self.random.pot()
        };
        self.mesh(frame, "vase", Form::lathe(&profile, 32), DVec3::ZERO, DVec3::ZERO, glaze);
        if self.random.chance(0.5) {
            let green = self.random.green();
            let leaves = self.random.count(6, 14);
            let bunch = Form::fronds(&mut self.random, leaves, tall * 1.1, 0.12 * tall, green);
            let base = v(0.0, 0.0, 0.62 * tall);
            self.mesh(frame, "twigs in the vase", bunch, base, DVec3::ZERO, Pattern::VertexColours);
        }
    }

    /// A plant in a pot, `tall` metres over all.
    pub(crate) fn potted(&mut self, frame: &Frame, tall: f64) {
        let (pot, radius) = (0.34 * tall, 0.2 * tall);
        let clay = self.random.pot();
        let profile = [
            (0.001, 0.0),
            (0.72 * radius, 0.0),
            (0.95 * radius, 0.86 * pot),
            (1.04 * radius, 0.86 * pot),
            (1.04 * radius, pot),
            (0.9 * radius, pot),
            (0.86 * radius, 0.8 * pot),
        ];
        self.mesh(frame, "pot", Form::lathe(&profile, 32), DVec3::ZERO, DVec3::ZERO, clay);
        self.column(
            frame,
            "earth in the pot",
            0.87 * radius,
            0.05 * pot,
            v(0.0, 0.0, 0.82 * pot),
            plain(EARTH),
        );
        let base = v(0.0, 0.0, 0.86 * pot);
        if self.random.chance(0.6) {
            let green = self.random.green();
            let (count, broad) = (self.random.count(12, 34), self.random.within(0.06, 0.16));
            let leaves = Form::fronds(&mut self.random, count, 0.85 * tall, broad * tall, green);
            self.mesh(frame, "plant", leaves, base, DVec3::ZERO, Pattern::VertexColours);
        } else {
            let stem = [base, base + v(0.0, 0.0, 0.35 * tall)];
            self.rod(frame, "stem of the plant", 0.02 * tall, stem, plain([0.36, 0.28, 0.18]));
            let sheets = Form::crown(&mut self.random, v(0.26, 0.26, 0.24) * tall, 60, 0.2 * tall);
            let leaves = self.random.leaves(0.07 * tall, 0.6);
            self.mesh(
                frame,
                "crown of the plant",
                sheets,
                base + v(0.0, 0.0, 0.4 * tall),
                DVec3::ZERO,
                leaves,
            );
        }
    }

    /// A bowl of fruit.
    pub(crate) fn bowl(&mut self, frame: &Frame) {
        let (radius, tall) = (self.random.within(0.11, 0.16), 0.07);
        let profile: Vec<(f64, f64)> = (0..=8)
            .map(|k| f64::from(k) / 8.0)
            .map(|t| (radius * (0.4 + 0.6 * t.powf(0.6)), tall * t * t + 0.001))
            .collect();
        let glaze = self.random.pot();
        let profile: Vec<_> = [(0.001, 0.0)].into_iter().chain(profile).collect();
        self.mesh(frame, "bowl", Form::lathe(&profile, 36), DVec3::ZERO, DVec3::ZERO, glaze);
        let kinds = [[0.82, 0.20, 0.14], [0.93, 0.58, 0.14], [0.60, 0.70, 0.22], [0.92, 0.82, 0.26]];
        let fruit = 0.036;
        for k in 0..5 {
            let level = DVec2::from_angle(f64::from(k) * 1.2566) * (0.52 * radius);
            let skin = self.random.pick(&kinds);
            let skin = plain(self.random.near(skin, 0.04));
            self.ball(frame, "fruit", fruit, level.extend(fruit + 0.022), skin);
        }
        let top = self.random.pick(&kinds);
        self.ball(frame, "fruit", fruit, v(0.0, 0.0, fruit + 0.066), plain(top));
    }

    /// Sheets of paper, the upper ones turned.
    pub(crate) fn papers(&mut self, frame: &Frame, count: u32) {
        for index in 0..count {
            let spot = frame.at(v(0.0, 0.0, f64::from(index) * 0.0012), self.random.within(-18.0, 18.0));
            let page = self.random.printed(0.0085);
            // Thick enough to be a body: a few sheets.
            self.block(&spot, "paper", v(0.21, 0.297, 0.001), v(0.0, 0.0, HAIR * 0.2), page);
        }
    }

    /// A picture in a frame on a wall: its middle at the origin, the wall at y = 0.
    pub(crate) fn picture(&mut self, frame: &Frame, size: DVec2) {
        let bar = self.random.within(0.015, 0.035);
        let (colour, deep) = (self.random.pick(&[BLACK, WHITE, BRASS, [0.42, 0.29, 0.18]]), 0.022);
        let colour = plain(colour);
        let line = size.min_element() * self.random.within(0.035, 0.07);
        let image = match self.random.count(0, 3) {
            0 => {
                let (a, b) = (self.random.strong(), self.random.paint());
                crate::stage::noise(a, b, 0.35 * size.x, 5)
            }
            1 => {
                let colours = [self.random.strong(), self.random.paint()];
                Pattern::Checker { colours, cell: 0.2 * size.min_element() }
            }
            _ => self.random.printed(line),
        };
        let (y, half) = (-0.5 * deep, 0.5 * size);
        for side in [-1.0, 1.0] {
            let upright = v(bar, deep, size.y);
            self.block(
                frame,
                "frame of a picture",
                upright,
                v(side * (half.x - 0.5 * bar), y, -half.y),
                colour,
            );
            let z = if side < 0.0 { -half.y } else { half.y - bar };
            let level = v(size.x - 2.0 * bar, deep, bar);
            self.block(frame, "frame of a picture", level, v(0.0, y, z), colour);
        }
        let canvas = v(size.x - 2.0 * bar, 0.01, size.y - 2.0 * bar);
        self.block(frame, "picture", canvas, v(0.0, -0.005, bar - half.y), image);
    }

    /// A table lamp with a shade.
    pub(crate) fn table_lamp(&mut self, frame: &Frame, lit: bool) {
        let tall = self.random.within(0.38, 0.5);
        let foot = self.random.pot();
        let profile: Vec<(f64, f64)> = (0..=12)
            .map(|k| f64::from(k) / 12.0)
            .map(|t| (0.012 + 0.06 * (PI * (0.15 + 0.85 * t)).sin().max(0.0), 0.55 * tall * t))
            .collect();
        let profile: Vec<_> =
            [(0.001, 0.0)].into_iter().chain(profile).chain([(0.001, 0.55 * tall)]).collect();
        self.mesh(frame, "foot of the lamp", Form::lathe(&profile, 28), DVec3::ZERO, DVec3::ZERO, foot);
        let stem = [v(0.0, 0.0, 0.5 * tall), v(0.0, 0.0, 0.8 * tall)];
        self.rod(frame, "stem of the lamp", 0.006, stem, plain(BRASS));
        self.shade(frame, 0.62 * tall, v(0.14, 0.09, 0.4 * tall), lit);
    }

    /// A lampshade from `z` on, with radii x below and y above and the height z, and its light if it is on.
    pub(crate) fn shade(&mut self, frame: &Frame, z: f64, size: DVec3, lit: bool) {
        let shell = [(size.x, 0.0), (size.y, size.z)];
        let cloth = plain(self.random.near([0.93, 0.86, 0.70], 0.04));
        let mesh = self.mesh(
            frame,
            "shade of the lamp",
            Form::lathe(&shell, 40),
            v(0.0, 0.0, z),
            DVec3::ZERO,
            cloth,
        );
        if lit {
            mesh.material.finish = crate::Finish::Baked;
        }
        // Spokes hold it.
        let spoke = |sign: f64| v(sign * size.x.midpoint(size.y), 0.0, z + 0.5 * size.z);
        self.rod(frame, "spoke of the lamp", 0.002, [spoke(-1.0), spoke(1.0)], plain(STEEL));
        if lit {
            let edge = DVec2::splat(1.2 * size.x);
            self.light(frame, "bulb", edge, v(0.0, 0.0, z + 0.02), [1.0, 0.86, 0.66], 0.5);
        }
    }
}
