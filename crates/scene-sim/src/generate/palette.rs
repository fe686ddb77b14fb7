//! Colours and patterns as houses have them.

use crate::random::Random;
use crate::stage::{noise, plain, print};
use crate::{Pattern, Rgb};

pub(crate) const WHITE: Rgb = [0.93, 0.925, 0.91];
pub(crate) const BLACK: Rgb = [0.10, 0.10, 0.11];
pub(crate) const STEEL: Rgb = [0.62, 0.63, 0.65];
pub(crate) const BRASS: Rgb = [0.76, 0.62, 0.36];
pub(crate) const EARTH: Rgb = [0.22, 0.16, 0.11];

/// Light and dark grain: oak, walnut, pine, beech, grey oak.
const TIMBERS: [[Rgb; 2]; 5] = [
    [[0.78, 0.62, 0.43], [0.58, 0.41, 0.25]],
    [[0.48, 0.33, 0.22], [0.30, 0.19, 0.12]],
    [[0.88, 0.74, 0.52], [0.72, 0.52, 0.31]],
    [[0.82, 0.66, 0.50], [0.68, 0.48, 0.34]],
    [[0.66, 0.60, 0.53], [0.47, 0.42, 0.36]],
];

/// Colours of fabrics, covers and doors.
const STRONG: [Rgb; 12] = [
    [0.70, 0.22, 0.18],
    [0.17, 0.33, 0.52],
    [0.20, 0.42, 0.34],
    [0.84, 0.64, 0.22],
    [0.40, 0.25, 0.42],
    [0.15, 0.20, 0.28],
    [0.86, 0.80, 0.68],
    [0.56, 0.30, 0.22],
    [0.28, 0.50, 0.56],
    [0.52, 0.56, 0.38],
    [0.78, 0.46, 0.34],
    [0.34, 0.34, 0.36],
];

/// Paints of walls: mostly near white.
const PAINTS: [Rgb; 10] = [
    [0.93, 0.92, 0.89],
    [0.92, 0.91, 0.90],
    [0.90, 0.87, 0.80],
    [0.84, 0.86, 0.84],
    [0.78, 0.84, 0.86],
    [0.74, 0.80, 0.72],
    [0.90, 0.80, 0.70],
    [0.88, 0.84, 0.62],
    [0.62, 0.70, 0.74],
    [0.80, 0.66, 0.60],
];

impl Random {
    pub(crate) fn strong(&mut self) -> Rgb {
        let colour = self.pick(&STRONG);
        self.near(colour, 0.06)
    }

    pub(crate) fn paint(&mut self) -> Rgb {
        let colour = self.pick(&PAINTS);
        self.near(colour, 0.02)
    }

    /// Planks of one kind of wood.
    pub(crate) fn timber(&mut self, plank: f64) -> Pattern {
        let [light, dark] = self.pick(&TIMBERS);
        Pattern::Wood { light, dark, plank }
    }

    /// What tables and shelves are made of: wood, or lacquer without any texture.
    pub(crate) fn board(&mut self, plank: f64) -> Pattern {
        match self.count(0, 5) {
            0 => plain(self.near(WHITE, 0.03)),
            1 => plain(self.near([0.24, 0.25, 0.27], 0.06)),
            _ => self.timber(plank),
        }
    }

    /// Covers of sofas, cushions and chairs.
    pub(crate) fn fabric(&mut self, coarse: f64) -> Pattern {
        let colour = self.strong();
        let dark = colour.map(|c| c * 0.72);
        match self.count(0, 4) {
            0 => plain(colour),
            1 => {
                let other = self.near([0.88, 0.85, 0.78], 0.05);
                Pattern::Checker { colours: [colour, other], cell: coarse }
            }
            _ => noise(dark, colour.map(|c| (c * 1.12).min(0.97)), 0.3 * coarse, 4),
        }
    }

    /// A wall of a room: most are plain paint.
    pub(crate) fn wallpaper(&mut self) -> Pattern {
        let colour = self.paint();
        match self.count(0, 9) {
            0 => {
                let brick = self.pick(&[[0.62, 0.36, 0.27], [0.80, 0.78, 0.75], [0.55, 0.42, 0.35]]);
                Pattern::Brick {
                    brick,
                    mortar: [0.78, 0.75, 0.70],
                    length: 0.25,
                    height: 0.083,
                    joint: 0.012,
                }
            }
            1 => {
                let other = self.near(colour, 0.10);
                Pattern::Checker { colours: [colour, other], cell: self.within(0.12, 0.3) }
            }
            2 => {
                let dark = self.strong();
                let dark = [0, 1, 2].map(|k| 0.75 * colour[k] + 0.25 * dark[k]);
                noise(dark, colour, self.within(0.05, 0.4), 3)
            }
            _ => plain(colour),
        }
    }

    /// A floor: boards, tiles, stone or a fitted carpet.
    pub(crate) fn flooring(&mut self) -> Pattern {
        match self.count(0, 6) {
            0 => {
                let (light, dark) =
                    (self.near([0.84, 0.82, 0.78], 0.06), self.near([0.35, 0.34, 0.34], 0.12));
                Pattern::Checker { colours: [light, dark], cell: self.within(0.2, 0.5) }
            }
            1 => {
                let tile = self.near([0.72, 0.62, 0.54], 0.08);
                Pattern::Brick {
                    brick: tile,
                    mortar: [0.55, 0.53, 0.50],
                    length: 0.6,
                    height: 0.3,
                    joint: 0.006,
                }
            }
            2 => {
                let colour = self.strong();
                noise(colour.map(|c| c * 0.8), colour, 0.05, 3)
            }
            _ => {
                let plank = self.within(0.09, 0.2);
                self.timber(plank)
            }
        }
    }

    /// A page, a poster, a package.
    pub(crate) fn printed(&mut self, line: f64) -> Pattern {
        let paper = self.pick(&[
            [0.95, 0.94, 0.90],
            [0.93, 0.90, 0.82],
            [0.86, 0.80, 0.68],
            [0.88, 0.92, 0.94],
            [0.97, 0.86, 0.55],
        ]);
        let accent = self.strong();
        print(self.near(paper, 0.03), accent, line)
    }

    /// Leaves of a tree or a bush.
    pub(crate) fn leaves(&mut self, leaf: f64, cover: f64) -> Pattern {
        let (dark, light) = self.pick(&[
            ([0.10, 0.20, 0.06], [0.42, 0.58, 0.22]),
            ([0.08, 0.17, 0.08], [0.30, 0.47, 0.22]),
            ([0.16, 0.24, 0.08], [0.55, 0.64, 0.28]),
            ([0.14, 0.20, 0.12], [0.44, 0.53, 0.36]),
        ]);
        Pattern::Foliage { dark, light: self.near(light, 0.05), leaf, cover: cover as f32 }
    }

    pub(crate) fn green(&mut self) -> Rgb {
        let green =
            self.pick(&[[0.28, 0.46, 0.18], [0.20, 0.38, 0.16], [0.40, 0.52, 0.22], [0.24, 0.42, 0.30]]);
        self.near(green, 0.05)
    }

    pub(crate) fn pot(&mut self) -> Pattern {
        match self.count(0, 3) {
            0 => plain(self.near([0.72, 0.40, 0.26], 0.05)),
            1 => plain(self.near(WHITE, 0.04)),
            2 => plain(self.strong()),
            _ => noise([0.46, 0.45, 0.43], [0.66, 0.64, 0.61], 0.1, 4),
        }
    }
}
