//! What encloses a room: floor, ceiling and walls with windows and doors, and what is seen through them.

use crate::generate::form::{Form, Opening};
use crate::generate::palette::{BLACK, BRASS, STEEL, WHITE};
use crate::generate::plants::LEAVES;
use crate::generate::set::{Frame, HAIR, Set};
use crate::stage::{noise, plain, v};
use crate::{MeshSource, Pattern, Rgb, Sky, Sun};
use glam::{DVec2, DVec3};

pub(crate) const THICK: f64 = 0.2;

/// What interrupts a wall, seen from inside.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    /// Its middle along the wall, metres from the wall's middle.
    pub(crate) x: f64,
    /// Height of its lower edge; 0 for a door.
    pub(crate) sill: f64,
    pub(crate) size: DVec2,
}

impl Window {
    pub(crate) fn is_door(&self) -> bool {
        self.sill <= 0.0
    }
}

/// One wall of a room.
#[derive(Debug, Clone)]
pub(crate) struct Wall {
    pub(crate) name: &'static str,
    /// In the middle of its foot, y into the wall.
    pub(crate) frame: Frame,
    pub(crate) length: f64,
    pub(crate) windows: Vec<Window>,
}

/// A room whose floor is centred on the origin.
pub(crate) struct Shell {
    /// Width along x, depth along y, height.
    pub(crate) size: DVec3,
    /// Back, right, left and front.
    pub(crate) walls: [Wall; 4],
}

impl Shell {
    pub(crate) fn new(size: DVec3) -> Self {
        let (x, y) = (0.5 * size.x, 0.5 * size.y);
        let wall = |name, place: DVec3, turn, length| Wall {
            name,
            frame: Frame::new(place, turn),
            length,
            windows: Vec::new(),
        };
        let walls = [
            wall("back wall", v(0.0, y, 0.0), 0.0, size.x),
            wall("right wall", v(x, 0.0, 0.0), -90.0, size.y),
            wall("left wall", v(-x, 0.0, 0.0), 90.0, size.y),
            wall("front wall", v(0.0, -y, 0.0), 180.0, size.x),
        ];
        Self { size, walls }
    }
}

impl Set {
    /// Builds the room with everything in its walls.
    pub(crate) fn enclose(&mut self, shell: &Shell) {
        let (size, world) = (shell.size, Frame::new(DVec3::ZERO, 0.0));
        let outer = size.truncate() + DVec2::splat(2.0 * THICK);
        let floor = self.random.flooring();
        self.block(&world, "floor", outer.extend(0.1), v(0.0, 0.0, -0.1), floor);
        let ceiling = plain(self.random.near(WHITE, 0.02));
        self.block(&world, "ceiling", outer.extend(0.2), v(0.0, 0.0, size.z), ceiling);
        let paper = self.random.wallpaper();
        let accent = self.random.chance(0.35);
        let skirting = if self.random.chance(0.6) { plain(WHITE) } else { self.random.timber(0.2) };
        for (index, wall) in shell.walls.iter().enumerate() {
            let pattern = if accent && index == 0 { self.random.wallpaper() } else { paper };
            self.wall(wall, size.z, index % 3 == 0, pattern);
            self.skirting(wall, skirting);
            for window in &wall.windows {
                let frame = wall.frame.at(v(window.x, 0.0, window.sill), 0.0);
                if window.is_door() {
                    self.door(&frame, window.size);
                } else {
                    self.window(&frame, window.size);
                }
            }
        }
    }

    fn wall(&mut self, wall: &Wall, height: f64, reaches_corners: bool, pattern: Pattern) {
        let beyond = if reaches_corners { THICK } else { 0.0 };
        let length = wall.length + 2.0 * beyond;
        let openings: Vec<Opening> = wall
            .windows
            .iter()
            .filter(|window| !window.is_door())
            .map(|w| Opening { corner: DVec2::new(w.x + 0.5 * (length - w.size.x), w.sill), size: w.size })
            .collect();
        let form = Form::wall(v(length, THICK, height), &openings);
        self.mesh(&wall.frame, wall.name, form, v(-0.5 * length, 0.0, 0.0), DVec3::ZERO, pattern);
    }

    fn skirting(&mut self, wall: &Wall, pattern: Pattern) {
        let end = 0.5 * wall.length - 0.013;
        let mut doors: Vec<[f64; 2]> = wall
            .windows
            .iter()
            .filter(|window| window.is_door())
            .map(|door| [door.x - 0.5 * door.size.x - 0.08, door.x + 0.5 * door.size.x + 0.08])
            .collect();
        doors.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut from = -end;
        for [start, stop] in doors.into_iter().chain([[end, end]]) {
            let length = start - from;
            if length > 0.02 {
                let place = v(from + 0.5 * length, -0.006, 0.0);
                self.block(&wall.frame, "skirting", v(length, 0.012, 0.07), place, pattern);
            }
            from = stop;
        }
    }

    /// A door in its frame on a wall, closed.
    fn door(&mut self, frame: &Frame, size: DVec2) {
        let paint = if self.random.chance(0.5) {
            plain(self.random.near(WHITE, 0.02))
        } else {
            self.random.timber(0.4)
        };
        let trim = 0.07;
        for side in [-1.0, 1.0] {
            let post = v(trim, 0.03, size.y);
            self.post(frame, "door frame", post, v(side * 0.5 * (size.x + trim), -0.015, 0.0), paint);
        }
        let lintel = v(size.x + 2.0 * trim, 0.03, trim);
        self.block(frame, "door frame", lintel, v(0.0, -0.015, size.y), paint);
        self.post(frame, "door", v(size.x - 0.006, 0.012, size.y - 0.012), v(0.0, -0.006, 0.008), paint);
        let panel = v(0.36 * size.x, 0.006, 0.38 * size.y);
        for (column, row) in [(-1.0, 0.0), (1.0, 0.0), (-1.0, 1.0), (1.0, 1.0)] {
            let place = v(column * 0.23 * size.x, -0.015, (0.08 + 0.46 * row) * size.y);
            self.post(frame, "door panel", panel, place, paint);
        }
        let knob = v(0.44 * size.x, -0.012, 0.5 * size.y);
        let metal = plain(self.random.pick(&[BRASS, STEEL, BLACK]));
        self.rod(frame, "door handle", 0.009, [knob, knob - v(0.0, 0.05, 0.0)], metal);
        self.rod(frame, "door handle", 0.008, [knob - v(0.0, 0.045, 0.0), knob - v(0.11, 0.045, 0.0)], metal);
    }

    /// Frame, bars and sill of a window, its lower edge in the middle at the origin; perhaps curtains and a plant.
    fn window(&mut self, frame: &Frame, size: DVec2) {
        let paint = plain(if self.random.chance(0.75) { WHITE } else { self.random.strong() });
        self.sash(frame, size, 0.11, paint);
        let sill = v(size.x + 0.1, 0.2, 0.03);
        self.block(frame, "window sill", sill, v(0.0, -0.1, -0.03 - HAIR), paint);
        if self.random.chance(0.6) {
            let count = self.random.count(1, 3);
            for k in 0..count {
                let x = size.x
                    * ((f64::from(k) + 0.5) / f64::from(count) - 0.5 + self.random.within(-0.06, 0.06));
                let spot = frame.at(v(x, -0.105, -HAIR), self.random.within(0.0, 360.0));
                if self.random.chance(0.7) {
                    let tall = self.random.within(0.2, 0.34);
                    self.potted(&spot, tall);
                } else {
                    let tall = self.random.within(0.14, 0.26);
                    self.vase(&spot, tall);
                }
            }
        }
        if self.random.chance(0.7) {
            let (colour, rail) = (self.random.strong(), size.y + 0.12);
            let pale = self.random.chance(0.5);
            let cloth = if pale { plain(self.random.near([0.90, 0.88, 0.82], 0.05)) } else { plain(colour) };
            let half = 0.5 * size.x + 0.3;
            let metal = plain(self.random.pick(&[BLACK, BRASS, STEEL]));
            let ends = [v(-half, -0.26, rail), v(half, -0.26, rail)];
            self.rod(frame, "curtain rail", 0.012, ends, metal);
            for side in [-1.0, 1.0] {
                let hook = v(side * (half - 0.05), 0.0, rail);
                self.rod(frame, "hook of the curtain rail", 0.008, [hook, hook - v(0.0, 0.26, 0.0)], metal);
                let wide = self.random.within(0.26, 0.4);
                let form = Form::curtain(DVec2::new(wide, size.y + 0.32), (wide / 0.07).round(), 0.05);
                let place = v(side * (half - 0.5 * wide - 0.02), -0.26, -0.2);
                self.mesh(frame, "curtain", form, place, DVec3::ZERO, cloth);
            }
        }
    }

    /// The wooden frame of a window with its bars, `deep` inside the wall.
    pub(crate) fn sash(&mut self, frame: &Frame, size: DVec2, deep: f64, paint: Pattern) {
        let (bar, thick) = (0.055, 0.05);
        for side in [-1.0, 1.0] {
            let place = v(side * 0.5 * (size.x - bar), deep, 0.0);
            self.block(frame, "window frame", v(bar, thick, size.y), place, paint);
            let z = if side < 0.0 { 0.0 } else { size.y - bar };
            self.block(frame, "window frame", v(size.x - 2.0 * bar, thick, bar), v(0.0, deep, z), paint);
        }
        let inner = size - DVec2::splat(2.0 * bar);
        let columns = (inner.x / self.random.within(0.4, 0.75)).round().max(1.0) as u32;
        for k in 1..columns {
            let x = inner.x * (f64::from(k) / f64::from(columns) - 0.5);
            self.block(frame, "window bar", v(0.04, 0.04, inner.y), v(x, deep, bar), paint);
        }
        if inner.y > 0.9 {
            // Thinner than the upright bars, which it passes through.
            let z = bar + inner.y * 0.68;
            self.block(frame, "window bar", v(inner.x, 0.03, 0.04), v(0.0, deep, z), paint);
        }
    }

    /// A radiator against a wall, its lower edge 0.1 m above the floor.
    pub(crate) fn radiator(&mut self, frame: &Frame, width: f64, tall: f64) {
        let white = plain(WHITE);
        let fins = (width / 0.05) as u32;
        for k in 0..fins {
            let x = 0.05 * (f64::from(k) - 0.5 * f64::from(fins - 1));
            self.block(frame, "fin of the radiator", v(0.032, 0.08, tall), v(x, -0.08, 0.1), white);
        }
        for z in [0.13, tall + 0.05] {
            let tube = [v(-0.5 * width, -0.08, z), v(0.5 * width, -0.08, z)];
            self.rod(frame, "pipe of the radiator", 0.018, tube, white);
        }
        for side in [-1.0, 1.0] {
            let z = 0.13;
            let foot = v(side * 0.4 * width, 0.0, z);
            self.rod(frame, "bracket of the radiator", 0.012, [foot, foot - v(0.0, 0.08, 0.0)], white);
        }
    }

    /// Ground, trees and houses outside a room whose floor is `floor` above the ground.
    pub(crate) fn outside(&mut self, shell: &Shell, floor: f64) {
        let ground = Frame::new(v(0.0, 0.0, -floor), 0.0);
        let grass = noise([0.30, 0.40, 0.18], [0.56, 0.64, 0.34], 1.5, 6);
        self.block(&ground, "outside ground", v(160.0, 160.0, 0.5), v(0.0, 0.0, -0.5), grass);
        for wall in shell.walls.iter().filter(|wall| wall.windows.iter().any(|w| !w.is_door())) {
            let frame = wall.frame.at(v(0.0, 0.0, -floor), 0.0);
            let (far, colour) = (self.random.within(16.0, 26.0), self.random.paint());
            for k in -1..=1 {
                let size = v(self.random.within(8.0, 11.0), 8.0, self.random.within(5.0, 9.0));
                let place = v(13.0 * f64::from(k), far + self.random.within(0.0, 4.0), 0.0);
                self.far_house(&frame.at(place, 0.0), size, colour);
            }
            for _ in 0..4 {
                let place = v(self.random.within(-9.0, 9.0), self.random.within(4.5, 11.0), 0.0);
                let tall = self.random.within(3.0, 6.5);
                self.tree(&frame.at(place, 0.0), "outside tree", tall, LEAVES);
            }
        }
    }

    /// A house far away: its front towards -y.
    fn far_house(&mut self, frame: &Frame, size: DVec3, colour: Rgb) {
        let wall = plain(self.random.near(colour, 0.08));
        self.block(frame, "outside house", size, v(0.0, 0.5 * size.y, 0.0), wall);
        let (glass, tile) = (plain([0.22, 0.26, 0.32]), self.random.near([0.50, 0.28, 0.22], 0.06));
        let (columns, rows) = ((size.x / 2.2) as u32, (size.z / 2.7) as u32);
        for column in 0..columns {
            for row in 0..rows {
                let x = size.x * ((f64::from(column) + 0.5) / f64::from(columns) - 0.5);
                let place = v(x, -0.02, 0.9 + 2.7 * f64::from(row));
                self.block(frame, "outside window", v(1.0, 0.04, 1.3), place, glass);
            }
        }
        let roof = Form::roof(size + v(0.8, 0.8, 2.4 - size.z), 0.2);
        let tiles = Pattern::Brick {
            brick: tile,
            mortar: tile.map(|c| 0.6 * c),
            length: 0.4,
            height: 0.3,
            joint: 0.03,
        };
        self.mesh(frame, "outside roof", roof, v(0.0, 0.5 * size.y, size.z - 0.01), DVec3::ZERO, tiles);
    }
}

impl Set {
    /// Bends leaves off the walls, the floor's edge and the ceiling of a room.
    pub(crate) fn bend_leaves(&mut self, shell: &Shell) {
        /// From here on leaves give way, metres from a wall.
        const NEAR: f64 = 0.05;
        let (low, high) = (0.5 * -shell.size, 0.5 * shell.size);
        let bent =
            |distance: f64| if distance < NEAR { NEAR * (distance / NEAR - 1.0).exp() } else { distance };
        for mesh in &mut self.meshes {
            let leaves = ["plant", "crown of the plant", "twigs in the vase"].contains(&mesh.name.as_str());
            let MeshSource::Inline { vertices, .. } = &mut mesh.source else { continue };
            // Plants in pots are only ever turned about the vertical.
            let turn = DVec2::from_angle(mesh.rotation.z.to_radians());
            for vertex in vertices.iter_mut().filter(|_| leaves) {
                let mut place = mesh.centre + turn.rotate(vertex.truncate()).extend(vertex.z);
                for axis in 0..2 {
                    place[axis] = high[axis] - bent(high[axis] - place[axis]);
                    place[axis] = low[axis] + bent(place[axis] - low[axis]);
                }
                place.z = shell.size.z - bent(shell.size.z - place.z);
                let offset = place - mesh.centre;
                *vertex = DVec2::new(turn.x, -turn.y).rotate(offset.truncate()).extend(offset.z);
            }
        }
    }
}

/// The light of a room: through its windows by day, by its lamps in the evening.
pub(crate) struct RoomLight {
    pub(crate) evening: bool,
    pub(crate) sky: Sky,
    pub(crate) sun: Option<Sun>,
}

impl Set {
    pub(crate) fn room_light(&mut self, shell: &Shell) -> RoomLight {
        let evening = self.random.chance(0.25);
        let occlusion = Some(crate::Occlusion { reach: self.random.within(1.2, 2.0), rays: 8 });
        if evening {
            let sky = Sky {
                zenith: [0.30, 0.32, 0.42],
                horizon: [0.52, 0.45, 0.46],
                ground: [0.44, 0.38, 0.33],
                light: 3.2,
                occlusion,
            };
            return RoomLight { evening, sky, sun: None };
        }
        let sky = Sky {
            zenith: [0.56, 0.70, 0.90],
            horizon: [0.93, 0.93, 0.92],
            // What the floor sends up to the ceiling.
            ground: [0.78, 0.75, 0.70],
            light: self.random.within(1.25, 1.6) as f32,
            occlusion,
        };
        let glazed = shell.walls.iter().find(|wall| wall.windows.iter().any(|w| !w.is_door()));
        let sun = glazed.filter(|_| self.random.chance(0.7)).map(|wall| {
            let towards = v(self.random.within(-0.7, 0.7), 1.0, self.random.within(0.35, 0.9));
            let origin = Frame::new(DVec3::ZERO, wall.frame.turn);
            let colour = [1.0, 0.95, 0.84];
            Sun { towards: origin.point(towards), colour, strength: 0.9, diameter: 0.0 }
        });
        RoomLight { evening, sky, sun }
    }
}
