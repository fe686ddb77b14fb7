//! Rooms to live in: furniture along three walls and in the middle; the camera walks along the fourth.

use crate::generate::Plan;
use crate::generate::palette::{BLACK, BRASS};
use crate::generate::set::{Frame, Set};
use crate::generate::shell::{RoomLight, Shell, Wall, Window};
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{plain, v};
use crate::{Finish, Trajectory};
use glam::{DVec2, DVec3};

/// Depth of the band along the front wall that the camera has to itself, metres.
const AISLE: f64 = 1.15;

/// What stands at a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Piece {
    Sofa,
    Bed,
    Bookcase,
    Sideboard,
    Desk,
    FloorLamp,
    Plant,
    Mirror,
    Armchair,
}

/// Draws a room's windows and doors.
pub(crate) fn openings(random: &mut Random, shell: &mut Shell, windows: u32) {
    let height = shell.size.z;
    let glazed = random.count(0, 2) as usize;
    for index in 0..3 {
        let wall = &mut shell.walls[index];
        if index == glazed {
            let count = if wall.length > 4.4 { windows } else { 1 };
            let pitch = (wall.length - 0.5) / f64::from(count);
            let wide = random.within(0.9, 1.7).min(pitch - 0.75);
            let sill = random.within(0.75, 1.0);
            let tall = (height - sill - 0.3).min(random.within(1.1, 1.6));
            for k in 0..count {
                let x = pitch * (f64::from(k) - 0.5 * f64::from(count - 1));
                wall.windows.push(Window { x, sill, size: DVec2::new(wide, tall) });
            }
        } else if index == (glazed + 1) % 3 || random.chance(0.2) {
            // At the end of the wall, where furniture ends too.
            let side = if index == 1 { 1.0 } else { -1.0 };
            let x = side * (0.5 * wall.length - 1.0);
            wall.windows.push(Window { x, sill: 0.0, size: DVec2::new(0.86, 2.05) });
        }
    }
}

impl Set {
    /// Fills the stretch `from..to` of a wall with pieces of furniture.
    pub(crate) fn line(
        &mut self,
        wall: &Wall,
        height: f64,
        from: f64,
        to: f64,
        pieces: &mut Vec<Piece>,
        light: &RoomLight,
    ) {
        let mut x = from;
        while to - x > 0.45 {
            let door = wall
                .windows
                .iter()
                .find(|w| w.is_door() && w.x + 0.5 * w.size.x + 0.1 > x && w.x - 0.5 * w.size.x - 0.12 < to);
            let end = door.map_or(to, |door| (door.x - 0.5 * door.size.x - 0.12).min(to));
            let piece = pieces.pop().unwrap_or(Piece::Plant);
            let wide = self.width(piece, (end - x).min(2.6));
            if wide > end - x {
                if pieces.is_empty() || end - x < 0.5 {
                    x = door.map_or(to, |door| door.x + 0.5 * door.size.x + 0.12);
                }
                continue;
            }
            let middle = x + 0.5 * wide;
            let behind = |w: &&Window| !w.is_door() && (w.x - middle).abs() < 0.5 * (w.size.x + wide) + 0.4;
            let window = wall.windows.iter().find(behind).copied();
            self.piece(&wall.frame.at(v(middle, -0.03, 0.0), 0.0), piece, wide, height, window, light);
            x += wide + self.random.within(0.05, 0.35);
        }
    }

    fn width(&mut self, piece: Piece, room: f64) -> f64 {
        let [low, high] = match piece {
            Piece::Sofa => [1.5, 2.2],
            Piece::Bed => [1.1, 1.8],
            Piece::Bookcase => [0.7, 1.8],
            Piece::Sideboard => [0.9, 1.7],
            Piece::Desk => [1.1, 1.5],
            Piece::FloorLamp | Piece::Plant => [0.5, 0.65],
            Piece::Mirror => [0.6, 0.9],
            Piece::Armchair => [0.85, 1.0],
        };
        if room < low { low } else { self.random.within(low, high.min(room)) }
    }

    /// One piece at a wall, `wide` metres of it.
    fn piece(
        &mut self,
        frame: &Frame,
        piece: Piece,
        wide: f64,
        height: f64,
        window: Option<Window>,
        light: &RoomLight,
    ) {
        let above = match piece {
            Piece::Sofa | Piece::Armchair => {
                // Off the wall, so that curtains and radiators have their place behind it.
                let gap = if window.is_some() { -0.3 } else { -0.05 };
                self.sofa(&frame.at(v(0.0, gap, 0.0), 0.0), wide);
                1.25
            }
            Piece::Bed => {
                let gap = if window.is_some() { -0.3 } else { 0.0 };
                self.bed(&frame.at(v(0.0, gap, 0.0), 0.0), wide);
                1.3
            }
            Piece::Bookcase if window.is_none() => {
                let tall = self.random.within(1.1, (height - 0.25).min(2.2));
                let deep = self.random.within(0.26, 0.34);
                self.bookcase(frame, v(wide, deep, tall));
                if tall < 1.3 {
                    self.on_top(&frame.at(v(0.0, -0.5 * deep, tall), 0.0), wide, light);
                }
                tall + 0.6
            }
            Piece::Mirror if window.is_none() => {
                let size = DVec2::new(wide - 0.1, self.random.within(1.0, 1.5));
                let place = frame.at(v(0.0, 0.03, 0.45 + 0.5 * size.y), 0.0);
                self.picture(&place, size);
                if let Some(glass) = self.primitives.last_mut() {
                    glass.name = "mirror".into();
                    glass.material.finish = Finish::Mirror;
                    glass.material.pattern = plain([0.93, 0.94, 0.94]);
                }
                3.0
            }
            Piece::Bookcase | Piece::Sideboard | Piece::Mirror => {
                let (deep, tall) = (self.random.within(0.36, 0.44), self.random.within(0.55, 0.72));
                let spot = frame.at(v(0.0, if window.is_some() { -0.24 } else { 0.0 }, 0.0), 0.0);
                self.sideboard(&spot, v(wide, deep, tall));
                self.on_top(&spot.at(v(0.0, -0.5 * deep, tall), 0.0), wide, light);
                1.25
            }
            Piece::Desk => {
                let spot = frame.at(v(0.0, if window.is_some() { -0.24 } else { 0.0 }, 0.0), 0.0);
                let (size, wood) = (v(wide, 0.65, 0.74), self.random.board(0.16));
                self.table(&spot.at(v(0.0, -0.33, 0.0), 0.0), "desk", size, wood);
                self.workplace(&spot.at(v(0.0, -0.33, 0.74), 0.0), wide, 0.65, light);
                let turn = self.random.within(150.0, 210.0);
                let x = self.random.within(-0.15, 0.15);
                self.office_chair(&spot.at(v(x, -0.95, 0.0), turn));
                1.5
            }
            Piece::FloorLamp => {
                self.floor_lamp(&frame.at(v(0.0, -0.3, 0.0), 0.0), light.evening);
                3.0
            }
            Piece::Plant => {
                let tall = self.random.within(0.7, 1.25);
                self.potted(&frame.at(v(0.0, -0.33, 0.0), 0.0), tall);
                3.0
            }
        };
        if window.is_none() && height - above > 0.85 {
            self.gallery(&frame.at(v(0.0, 0.03, 0.0), 0.0), wide, above, height);
        }
    }

    /// Pictures on the wall over a piece of furniture.
    fn gallery(&mut self, frame: &Frame, wide: f64, above: f64, height: f64) {
        let room = (height - above - 0.25).min(0.9);
        if wide < 0.5 || self.random.chance(0.15) {
            return;
        }
        let count = if wide > 1.3 { self.random.count(1, 3) } else { 1 };
        let each = wide / f64::from(count);
        for k in 0..count {
            let x = each * (f64::from(k) + 0.5) - 0.5 * wide;
            let size = DVec2::new(
                (each - 0.12).min(self.random.within(0.35, 1.2)),
                room * self.random.within(0.55, 1.0),
            );
            let z = above + 0.5 * room + self.random.within(-0.03, 0.03);
            self.picture(&frame.at(v(x, 0.0, z), 0.0), size);
        }
    }

    /// Things on a sideboard or a low shelf, the middle of its top at the origin.
    fn on_top(&mut self, frame: &Frame, wide: f64, light: &RoomLight) {
        let count = (wide / 0.36).floor().max(1.0) as u32;
        let each = wide / f64::from(count);
        for k in 0..count {
            let spot = frame
                .at(v(each * (f64::from(k) + 0.5) - 0.5 * wide, 0.0, 0.0), self.random.within(-20.0, 20.0));
            match self.random.count(0, 6) {
                0 => self.table_lamp(&spot, light.evening),
                1 => {
                    let tall = self.random.within(0.2, 0.36);
                    self.vase(&spot, tall);
                }
                2 => {
                    let tall = self.random.within(0.25, 0.42);
                    self.potted(&spot, tall);
                }
                3 => {
                    let top = {
                        let n = self.random.count(2, 5);
                        self.pile_of_books(&spot, n, 0.25)
                    };
                    self.mug(&spot.at(v(0.0, 0.0, top), 0.0));
                }
                4 => self.bowl(&spot),
                5 => self.books(&spot.at(v(-0.14, 0.1, 0.0), 0.0), 0.28, 0.2, 0.27),
                _ => {}
            }
        }
    }

    /// A screen, a keyboard and what gathers around them; the middle of the top at the origin, its back at +y.
    pub(crate) fn workplace(&mut self, frame: &Frame, wide: f64, deep: f64, light: &RoomLight) {
        let (back, front) = (0.5 * deep, -0.5 * deep);
        let x = self.random.within(-0.1, 0.1);
        let screen = self.random.within(0.48, 0.66);
        let turns = [self.random.within(-8.0, 8.0), self.random.within(-4.0, 4.0)];
        self.monitor(&frame.at(v(x, back - 0.2, 0.0), turns[0]), screen);
        self.keyboard(&frame.at(v(x, front + 0.14, 0.0), turns[1]));
        let edge = 0.5 * wide;
        let side = if self.random.chance(0.5) { 1.0 } else { -1.0 };
        let lamp = frame.at(v(side * (edge - 0.14), back - 0.13, 0.0), if side > 0.0 { 180.0 } else { 0.0 });
        let lit = light.evening || self.random.chance(0.3);
        self.desk_lamp(&lamp, lit);
        let y = self.random.within(-0.06, 0.06);
        self.mug(&frame.at(v(-side * (0.3 * wide).max(0.33), y, 0.0), 0.0));
        let pile = frame.at(v(-side * (edge - 0.16), back - 0.16, 0.0), self.random.within(-10.0, 10.0));
        if self.random.chance(0.6) {
            let count = self.random.count(2, 6);
            self.pile_of_books(&pile, count, 0.25);
        } else {
            let tall = self.random.within(0.24, 0.36);
            self.potted(&pile, tall);
        }
    }

    /// What stands in the middle of the room: a dining table with chairs, or a low table on a carpet.
    fn middle(&mut self, frame: &Frame, room: DVec2, ceiling: f64, light: &RoomLight) {
        let dining = room.y > 1.9 && room.x > 2.3 && self.random.chance(0.5);
        let carpet = DVec2::new(self.random.within(1.6, 2.6), self.random.within(1.2, 1.8)).min(room);
        if self.random.chance(0.75) {
            let turn = self.random.within(-5.0, 5.0);
            self.carpet(&frame.at(DVec3::ZERO, turn), carpet);
        }
        let frame = &frame.at(DVec3::ZERO, self.random.within(-6.0, 6.0));
        let wood = self.random.board(0.15);
        if !dining {
            let size = v(
                self.random.within(0.8, 1.2),
                self.random.within(0.5, 0.65),
                self.random.within(0.36, 0.46),
            );
            self.table(frame, "low table", size, wood);
            let top = frame.at(v(0.0, 0.0, size.z), 0.0);
            self.bowl(&top.at(v(-0.25 * size.x, 0.06, 0.0), 0.0));
            let book = self.random.count(1, 3);
            self.pile_of_books(&top.at(v(0.18 * size.x, -0.04, 0.0), 12.0), book, 0.28);
            self.mug(&top.at(v(0.4 * size.x, 0.12, 0.0), 0.0));
            return;
        }
        let size = v(self.random.within(1.3, (room.x - 0.7).min(1.9)), self.random.within(0.8, 0.95), 0.74);
        self.table(frame, "table", size, wood);
        let (chair, seat) = (self.random.board(0.1), self.random.fabric(0.03));
        for side in [-1.0, 1.0] {
            for k in [-0.25, 0.25] {
                let out = 0.5 * size.y + self.random.within(-0.04, 0.12);
                let turn = if side > 0.0 { 0.0 } else { 180.0 } + self.random.within(-12.0, 12.0);
                self.chair(&frame.at(v(k * size.x, side * out, 0.0), turn), chair, seat);
            }
        }
        let top = frame.at(v(0.0, 0.0, 0.74), 0.0);
        self.bowl(&top.at(v(-0.05, 0.0, 0.0), 0.0));
        let tall = self.random.within(0.2, 0.34);
        self.vase(&top.at(v(0.34, 0.1, 0.0), 0.0), tall);
        self.papers(&top.at(v(-0.42, -0.1, 0.0), 20.0), 2);
        self.mug(&top.at(v(-0.3, 0.2, 0.0), 0.0));
        let cord = [v(0.0, 0.0, 0.74 + 0.72), v(0.0, 0.0, ceiling - 0.01)];
        self.rod(frame, "cord of the lamp", 0.006, cord, plain(BLACK));
        self.column(frame, "rose of the lamp", 0.05, 0.02, v(0.0, 0.0, ceiling - 0.02), plain(BRASS));
        self.shade(frame, 0.74 + 0.62, v(0.24, 0.1, 0.22), light.evening);
    }
}

pub(crate) fn room(set: &mut Set) -> Plan {
    let size = v(set.random.within(4.0, 5.8), set.random.within(4.2, 5.8), set.random.within(2.45, 2.95));
    let mut shell = Shell::new(size);
    let windows = set.random.count(1, 2);
    openings(&mut set.random, &mut shell, windows);
    set.enclose(&shell);
    let light = set.room_light(&shell);
    let floor = set.random.pick(&[0.5, 3.2, 6.0]);
    set.outside(&shell, floor);

    let main = set.random.pick(&[Piece::Sofa, Piece::Sofa, Piece::Bed, Piece::Desk]);
    let mut pieces = vec![
        Piece::FloorLamp,
        Piece::Bookcase,
        Piece::Sideboard,
        Piece::Plant,
        Piece::Bookcase,
        Piece::Armchair,
        Piece::Desk,
        Piece::Mirror,
        Piece::Plant,
    ];
    set.random.shuffle(&mut pieces);
    let half = 0.5 * size;
    // The last one is placed first.
    pieces.push(main);
    let reach = half.x - 0.15;
    set.line(&shell.walls[0], size.z, -reach, reach, &mut pieces, &light);
    // Side walls: from the depth of what stands at the back wall to the aisle.
    let deep = if main == Piece::Bed { 2.25 } else { 1.3 };
    set.line(&shell.walls[1], size.z, -half.y + deep, half.y - AISLE, &mut pieces, &light);
    set.line(&shell.walls[2], size.z, -half.y + AISLE, half.y - deep, &mut pieces, &light);
    for wall in &shell.walls {
        for window in wall.windows.iter().filter(|window| !window.is_door()) {
            let (wide, tall) = (window.size.x * 0.8, window.sill - 0.24);
            set.radiator(&wall.frame.at(v(window.x, 0.0, 0.0), 0.0), wide, tall.min(0.6));
        }
    }
    let (back, front) = (half.y - if main == Piece::Bed { 2.5 } else { 1.45 }, -half.y + AISLE + 0.35);
    if back - front > 0.9 {
        let place = v(set.random.within(-0.15, 0.15), 0.5 * (back + front), 0.0);
        set.middle(&Frame::new(place, 0.0), DVec2::new(size.x - 2.1, back - front), size.z, &light);
    }
    if light.evening {
        let top = v(0.0, -0.1, size.z - 0.04);
        let world = Frame::new(DVec3::ZERO, 0.0);
        set.block(&world, "ceiling lamp", v(0.5, 0.5, 0.04), top, plain([0.9; 3]));
        set.light(
            &world,
            "ceiling light",
            DVec2::splat(0.46),
            top - v(0.0, 0.0, 0.003),
            [1.0, 0.92, 0.80],
            1.3,
        );
    }
    set.bend_leaves(&shell);
    let draw = move |random: &mut Random| {
        let y = -half.y + random.within(0.45, 0.65);
        let (far, high) = (half.x - random.within(0.6, 1.1), random.within(1.2, 1.65));
        let side = if random.chance(0.5) { 1.0 } else { -1.0 };
        let places = [-1.0, 0.0, 1.0]
            .map(|k| v(side * k * far, y + 0.12 * (1.0 - f64::abs(k)), high + random.within(-0.06, 0.06)));
        let aim = random.within(0.15, 0.6) * half.x;
        let targets = [-1.0, 0.0, 1.0]
            .map(|k| v(-side * k * aim, half.y - random.within(0.2, 1.0), random.within(0.75, 1.1)));
        by_hand(random, Trajectory::Through { places: places.to_vec(), targets: targets.to_vec() })
    };
    Plan {
        sky: light.sky,
        sun: light.sun,
        wish: Wish { field_of_view: [64.0, 74.0], coverage: 0.96, open: 1.0 },
        draw: Box::new(draw),
    }
}
