//! A town house: its front at y = 0 towards -y, its middle at x = 0, the ground at z = 0.

use crate::generate::form::{Form, Opening};
use crate::generate::palette::{BLACK, BRASS, STEEL, WHITE};
use crate::generate::set::{Frame, Set};
use crate::stage::{noise, plain, v};
use crate::{Finish, Pattern, Rgb};
use glam::{DVec2, DVec3};

/// Thickness of the front.
const FRONT: f64 = 0.34;
/// Depth of a house.
const DEEP: f64 = 8.0;

/// What the houses of a street have in common, and what one has to itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    wall: Pattern,
    trim: Pattern,
    paint: Pattern,
    tile: Rgb,
    shutters: Option<Pattern>,
    /// Whether its panes are glass; else they are dull and cost nothing.
    glass: bool,
    lintels: bool,
}

impl Set {
    pub(crate) fn style(&mut self, glass: bool) -> Style {
        let colour = self.random.pick(&[
            [0.90, 0.86, 0.76],
            [0.88, 0.80, 0.62],
            [0.80, 0.62, 0.50],
            [0.74, 0.80, 0.82],
            [0.82, 0.82, 0.78],
            [0.70, 0.76, 0.64],
            [0.86, 0.70, 0.64],
        ]);
        let colour = self.random.near(colour, 0.04);
        let wall = match self.random.count(0, 5) {
            0 | 1 => {
                let brick = self.random.pick(&[[0.60, 0.32, 0.24], [0.68, 0.46, 0.34], [0.52, 0.28, 0.24]]);
                Pattern::Brick {
                    brick,
                    mortar: [0.72, 0.69, 0.63],
                    length: 0.25,
                    height: 0.083,
                    joint: 0.012,
                }
            }
            2 => {
                let mortar = [0.62, 0.58, 0.52];
                Pattern::Brick { brick: [0.74, 0.69, 0.60], mortar, length: 0.7, height: 0.35, joint: 0.018 }
            }
            3 => noise(colour.map(|c| 0.86 * c), colour, 0.35, 6),
            _ => plain(colour),
        };
        let pale = self.random.near([0.86, 0.84, 0.79], 0.05);
        let paint = if self.random.chance(0.7) { plain(WHITE) } else { plain(self.random.strong()) };
        let shutter = self.random.strong();
        let tile = self.random.pick(&[[0.55, 0.28, 0.20], [0.34, 0.34, 0.37], [0.46, 0.32, 0.26]]);
        Style {
            wall,
            trim: plain(pale),
            paint,
            tile,
            shutters: self.random.chance(0.35).then_some(plain(shutter)),
            glass,
            lintels: self.random.chance(0.7),
        }
    }

    /// Builds a house `wide` metres wide and returns its height at the eaves.
    pub(crate) fn house(&mut self, frame: &Frame, wide: f64, storeys: u32, style: &Style) -> f64 {
        let (ground, upper) = (self.random.within(3.3, 3.9), self.random.within(2.8, 3.2));
        let tall = ground + upper * f64::from(storeys - 1) + 0.35;
        let columns = (wide / self.random.within(2.1, 2.9)).round().max(2.0) as u32;
        let pitch = (wide - 0.6) / f64::from(columns);
        let pane = DVec2::new(pitch * self.random.within(0.42, 0.56), upper * self.random.within(0.52, 0.62));
        let door = self.random.count(0, columns - 1);
        let shop = self.random.chance(0.4);
        let balconies = storeys > 1 && self.random.chance(0.5);
        let balcony = self.random.count(0, columns - 1);
        let mut openings = Vec::new();
        for column in 0..columns {
            let x = pitch * (f64::from(column) + 0.5) - 0.5 * (wide - 0.6);
            for row in 0..storeys {
                let storey = if row == 0 { 0.0 } else { ground + upper * f64::from(row - 1) };
                let bay = frame.at(v(x, 0.0, storey), 0.0);
                let opening = |z: f64, size: DVec2| Opening {
                    corner: DVec2::new(x + 0.5 * (wide - size.x), storey + z),
                    size,
                };
                if row == 0 && column == door {
                    let size = DVec2::new(1.1, 2.6);
                    openings.push(opening(0.3, size));
                    self.front_door(&bay.at(v(0.0, 0.0, 0.3), 0.0), size, style);
                } else if row == 0 && shop {
                    let size = DVec2::new(pitch - 0.4, 2.1);
                    openings.push(opening(0.55, size));
                    self.shop_window(&bay.at(v(0.0, 0.0, 0.55), 0.0), size, style);
                } else if row > 0 && balconies && (column == balcony || column + 1 == columns - balcony) {
                    let size = DVec2::new(pane.x.max(0.9), 2.25);
                    openings.push(opening(0.06, size));
                    self.pane(&bay.at(v(0.0, 0.0, 0.06), 0.0), size, style, false);
                    self.balcony(&bay, (size.x + 0.9).min(pitch - 0.1));
                } else {
                    let sill = if row == 0 { 1.05 } else { 0.85 };
                    openings.push(opening(sill, pane));
                    self.pane(&bay.at(v(0.0, 0.0, sill), 0.0), pane, style, true);
                }
            }
        }
        let front = Form::wall(v(wide, FRONT, tall), &openings);
        self.mesh(frame, "front of a house", front, v(-0.5 * wide, 0.0, 0.0), DVec3::ZERO, style.wall);
        self.body(frame, wide, tall, style);
        self.ornaments(frame, v(wide, ground, tall), storeys, upper, style);
        if shop {
            let z = ground - 0.62;
            let board = self.random.printed(0.1);
            self.block(frame, "sign", v(0.7 * wide, 0.06, 0.5), v(0.0, -0.03, z), board);
        }
        tall
    }

    /// What is behind the front, and the roof.
    fn body(&mut self, frame: &Frame, wide: f64, tall: f64, style: &Style) {
        for side in [-1.0, 1.0] {
            let place = v(side * 0.5 * (wide - 0.2), FRONT + 0.5 * DEEP, 0.0);
            self.block(frame, "side of a house", v(0.2, DEEP, tall), place, style.wall);
        }
        let dark = noise([0.09, 0.08, 0.08], [0.24, 0.21, 0.18], 0.9, 3);
        let inner = v(wide - 0.4, DEEP - 1.0, tall);
        self.block(frame, "inside of a house", inner, v(0.0, FRONT + 1.0 + 0.5 * inner.y, 0.0), dark);
        let lid = v(wide - 0.4, 1.0, 0.1);
        self.block(frame, "attic floor", lid, v(0.0, FRONT + 0.5, tall - 0.1), dark);
        let (over, rise) = (0.45, self.random.within(1.6, 3.0));
        let roof = Form::roof(v(wide, DEEP + FRONT + 2.0 * over, rise), 0.16);
        let tiles = Pattern::Brick {
            brick: style.tile,
            mortar: style.tile.map(|c| 0.55 * c),
            length: 0.28,
            height: 0.3,
            joint: 0.03,
        };
        let middle = 0.5 * (DEEP + FRONT);
        self.mesh(frame, "roof", roof, v(0.0, middle, tall + 0.002), DVec3::ZERO, tiles);
        for side in [-1.0, 1.0] {
            let gable = Form::gable(DEEP + FRONT, rise);
            let place = v(side * (0.5 * wide - 0.03), middle, tall);
            self.mesh(frame, "gable", gable, place, DVec3::ZERO, style.wall);
        }
        let x = self.random.within(-0.35, 0.35) * wide;
        let chimney = v(0.7, 0.5, 1.2 + 0.6 * rise);
        let brick = Pattern::Brick {
            brick: [0.55, 0.32, 0.26],
            mortar: [0.65; 3],
            length: 0.25,
            height: 0.083,
            joint: 0.012,
        };
        self.block(frame, "chimney", chimney, v(x, middle - 1.0, tall + 0.3 * rise), brick);
        let metal = plain(self.random.pick(&[[0.45, 0.47, 0.48], [0.42, 0.32, 0.24], [0.30, 0.31, 0.33]]));
        let eaves = v(0.0, -over - 0.04, tall - 0.02);
        let half = v(0.5 * wide - 0.01, 0.0, 0.0);
        self.rod(frame, "gutter", 0.07, [eaves - half, eaves + half], metal);
        let pipe = v(0.5 * wide - 0.15, -0.07, 0.0);
        let bend = v(pipe.x, pipe.y, tall - 0.45);
        self.rod(frame, "downpipe", 0.045, [pipe, bend], metal);
        self.rod(frame, "downpipe", 0.045, [bend, v(pipe.x, eaves.y, tall - 0.06)], metal);
    }

    /// Plinth, bands between storeys and the cornice.
    fn ornaments(&mut self, frame: &Frame, size: DVec3, storeys: u32, upper: f64, style: &Style) {
        let band = v(size.x - 0.01, 0.09, 0.16);
        self.block(frame, "cornice", v(size.x - 0.01, 0.28, 0.26), v(0.0, -0.14, size.z - 0.27), style.trim);
        if self.random.chance(0.7) {
            for row in 0..storeys - 1 {
                let z = size.y + upper * f64::from(row) - 0.16;
                self.block(frame, "band", band, v(0.0, -0.045, z), style.trim);
            }
        }
        if style.shutters.is_none() && self.random.chance(0.5) {
            let (count, stone) = ((size.z / 0.5) as u32, v(0.4, 0.05, 0.3));
            for k in 0..count {
                for side in [-1.0, 1.0] {
                    let x = side * (0.5 * size.x - 0.21 - 0.06 * f64::from(k % 2));
                    let place = v(x, -0.025, 0.1 + 0.46 * f64::from(k));
                    if place.z < size.z - 0.6 {
                        self.block(frame, "corner stone", stone, place, style.trim);
                    }
                }
            }
        }
    }

    /// What fills an opening: sash, pane, curtains or a blind, and what surrounds it.
    fn pane(&mut self, frame: &Frame, size: DVec2, style: &Style, sill: bool) {
        self.sash(frame, size, 0.16, style.paint);
        let middle = v(0.0, 0.19, 0.5 * size.y);
        let (shape, upright) =
            (crate::Shape::Rectangle { width: size.x - 0.02, height: size.y - 0.02 }, v(90.0, 0.0, 0.0));
        if style.glass {
            let clear = plain([0.93, 0.95, 0.95]);
            let pane = self.put(frame, "pane", shape, middle, upright, clear);
            pane.material.finish = Finish::Glass { index: 1.5 };
        } else {
            let dull = self.random.near([0.27, 0.32, 0.38], 0.06);
            self.put(frame, "pane", shape, middle, upright, plain(dull));
        }
        if style.glass && self.random.chance(0.6) {
            let cloth = plain(self.random.near([0.88, 0.86, 0.80], 0.08));
            for side in [-1.0, 1.0] {
                let wide = size.x * self.random.within(0.16, 0.4);
                let form = Form::curtain(DVec2::new(wide, size.y + 0.05), (wide / 0.09).round(), 0.05);
                let place = v(side * 0.5 * (size.x - wide), 0.28, -0.02);
                self.mesh(frame, "curtain", form, place, DVec3::ZERO, cloth);
            }
        }
        if sill {
            let board = v(size.x + 0.16, 0.16, 0.06);
            self.block(frame, "window sill", board, v(0.0, -0.08, -0.06), style.trim);
            if self.random.chance(0.2) {
                let extent = DVec2::new(0.8 * size.x, 0.14);
                self.block(
                    frame,
                    "flower box",
                    extent.extend(0.15),
                    v(0.0, -0.08, 0.0),
                    plain([0.45, 0.27, 0.18]),
                );
                self.flower_bed(&frame.at(v(0.0, -0.08, 0.15), 0.0), extent - DVec2::splat(0.02));
            }
        }
        if style.lintels {
            let head = v(size.x + 0.2, 0.06, 0.14);
            self.block(frame, "lintel", head, v(0.0, -0.03, size.y + 0.02), style.trim);
        }
        if let Some(paint) = style.shutters.filter(|_| sill) {
            let leaf = v(0.36 * size.x, 0.03, size.y);
            for side in [-1.0, 1.0] {
                let x = side * (0.5 * size.x + 0.5 * leaf.x + 0.02);
                self.block(frame, "shutter", leaf, v(x, -0.015, 0.0), paint);
                let slats = (size.y / 0.09) as u32 - 1;
                for k in 0..slats {
                    let place = v(x, -0.036, 0.06 + 0.09 * f64::from(k));
                    self.block(frame, "slat of the shutter", v(leaf.x - 0.12, 0.012, 0.06), place, paint);
                }
            }
        }
    }

    fn balcony(&mut self, frame: &Frame, wide: f64) {
        let (out, tall) = (0.9, 0.95);
        let slab = plain(self.random.near([0.66, 0.65, 0.62], 0.05));
        self.block(frame, "balcony", v(wide, out, 0.14), v(0.0, -0.5 * out, -0.1), slab);
        let iron = plain(self.random.pick(&[BLACK, [0.2, 0.26, 0.24], WHITE]));
        let base = 0.04;
        for side in [-1.0, 1.0] {
            let x = side * (0.5 * wide - 0.03);
            for k in 0..7 {
                let foot = v(x, -0.06 - 0.115 * f64::from(k), base);
                self.block(frame, "bar of the balcony", v(0.016, 0.016, tall), foot, iron);
            }
            let rail = [v(x, 0.0, base + tall), v(x, 0.03 - out, base + tall)];
            self.rod(frame, "rail of the balcony", 0.022, rail, iron);
        }
        let count = (wide / 0.11) as u32;
        for k in 0..count {
            let x = wide * ((f64::from(k) + 0.5) / f64::from(count) - 0.5);
            let foot = v(x * 0.96, 0.03 - out, base);
            self.block(frame, "bar of the balcony", v(0.016, 0.016, tall), foot, iron);
        }
        let rail = v(0.5 * wide - 0.03, 0.03 - out, base + tall);
        self.rod(frame, "rail of the balcony", 0.022, [v(-rail.x, rail.y, rail.z), rail], iron);
        if self.random.chance(0.5) {
            let tall = self.random.within(0.5, 0.9);
            self.potted(&frame.at(v(0.32 * wide, -0.35, base), 0.0), tall);
        }
    }

    fn front_door(&mut self, frame: &Frame, size: DVec2, style: &Style) {
        let paint =
            if self.random.chance(0.6) { plain(self.random.strong()) } else { self.random.timber(0.18) };
        let door = v(size.x - 0.16, 0.06, 2.05);
        self.post(frame, "door", door, v(0.0, 0.16, 0.0), paint);
        for side in [-1.0, 1.0] {
            self.block(
                frame,
                "door post",
                v(0.08, 0.12, size.y),
                v(side * 0.5 * (size.x - 0.08), 0.16, 0.0),
                style.paint,
            );
            for row in 0..3 {
                let place = v(side * 0.22 * size.x, 0.12, 0.16 + 0.63 * f64::from(row));
                self.post(frame, "door panel", v(0.32 * size.x, 0.02, 0.5), place, paint);
            }
        }
        self.block(frame, "door head", v(size.x - 0.16, 0.1, 0.08), v(0.0, 0.16, 2.05), style.paint);
        let light = v(size.x - 0.16, 0.02, size.y - 2.13);
        self.block(frame, "fanlight", light, v(0.0, 0.18, 2.13), plain([0.30, 0.35, 0.41]));
        self.ball(frame, "door knob", 0.035, v(0.33 * size.x, 0.11, 1.0), plain(BRASS));
        for step in 0..2 {
            let (rise, go) = (0.15, 0.32);
            let size = v(size.x + 0.5 + 0.4 * f64::from(1 - step), go * f64::from(2 - step), rise);
            let place = v(0.0, -0.5 * size.y, -0.3 + rise * f64::from(step));
            self.block(frame, "doorstep", size, place, style.trim);
        }
        self.block(frame, "threshold", v(size.x, 0.3, 0.02), v(0.0, 0.17, -0.02), style.trim);
        let number = self.random.printed(0.03);
        self.block(frame, "house number", v(0.22, 0.015, 0.28), v(0.5 * size.x + 0.32, -0.0075, 1.5), number);
        if self.random.chance(0.5) {
            let roof = Form::roof(v(size.x + 0.6, 1.4, 0.5), 0.05);
            let tiles = Pattern::Wood { light: style.tile, dark: style.tile.map(|c| 0.6 * c), plank: 0.2 };
            self.mesh(frame, "porch", roof, v(0.0, 0.0, size.y + 0.12), DVec3::ZERO, tiles);
        } else {
            let bracket = v(-0.5 * size.x - 0.28, 0.0, 2.1);
            self.rod(
                frame,
                "bracket of the lantern",
                0.015,
                [bracket, bracket - v(0.0, 0.2, 0.0)],
                plain(BLACK),
            );
            let glass = plain([0.93, 0.88, 0.72]);
            self.block(frame, "lantern", v(0.14, 0.14, 0.24), bracket + v(0.0, -0.2, -0.24), glass);
        }
    }

    fn shop_window(&mut self, frame: &Frame, size: DVec2, style: &Style) {
        self.pane(frame, size, &Style { shutters: None, lintels: false, ..*style }, false);
        let poster = self.random.printed(0.05);
        self.block(frame, "poster", v(0.5, 0.01, 0.7), v(-0.22 * size.x, 0.12, 0.3), poster);
        self.rod(
            frame,
            "post of the poster",
            0.01,
            [v(-0.22 * size.x, 0.12, 0.0), v(-0.22 * size.x, 0.12, 0.31)],
            plain(STEEL),
        );
        if self.random.chance(0.7) {
            // The stripes of an awning run down its slope.
            let (out, drop) = (1.1, 0.45);
            let cloth = [WHITE, self.random.strong()];
            let count = ((size.x + 0.3) / 0.24) as u32;
            let slope = f64::atan2(drop, out).to_degrees();
            for k in 0..count {
                let x = 0.24 * (f64::from(k) - 0.5 * f64::from(count - 1));
                let shape = crate::Shape::Box { size: v(0.239, f64::hypot(out, drop), 0.012) };
                let place = v(x, -0.5 * out, size.y + 0.34 - 0.5 * drop);
                self.put(frame, "awning", shape, place, v(slope, 0.0, 0.0), plain(cloth[(k % 2) as usize]));
            }
        }
    }
}
