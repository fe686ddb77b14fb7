//! A desk at a wall; the camera goes around it.

use crate::Trajectory;
use crate::generate::Plan;
use crate::generate::palette::STEEL;
use crate::generate::set::{Frame, Set};
use crate::generate::shell::{RoomLight, Shell, Window};
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{plain, v};
use glam::{DVec2, DVec3};

impl Set {
    /// A board with notes on a wall, its middle at the origin.
    fn pinboard(&mut self, frame: &Frame, size: DVec2) {
        let cork = crate::stage::noise([0.55, 0.38, 0.22], [0.80, 0.62, 0.42], 0.02, 4);
        self.block(frame, "pinboard", v(size.x, 0.015, size.y), v(0.0, -0.0075, -0.5 * size.y), cork);
        let (columns, rows) = ((size.x / 0.2) as u32, (size.y / 0.24) as u32);
        for column in 0..columns {
            for row in 0..rows {
                if self.random.chance(0.2) {
                    continue;
                }
                let x = size.x * ((f64::from(column) + 0.5) / f64::from(columns) - 0.5);
                let z = size.y * ((f64::from(row) + 0.5) / f64::from(rows) - 0.5);
                let note = v(self.random.within(0.09, 0.14), 0.001, self.random.within(0.1, 0.18));
                let (page, tilt) = (self.random.printed(0.009), self.random.within(-9.0, 9.0));
                let shape = crate::Shape::Box { size: note };
                self.put(frame, "note", shape, v(x, -0.0156, z), v(0.0, tilt, 0.0), page);
                let pin = plain(self.random.strong());
                self.ball(frame, "pin", 0.006, v(x, -0.019, z + 0.4 * note.z), pin);
            }
        }
    }

    /// A board on the wall with books and small things, its underside at the origin.
    fn wall_shelf(&mut self, frame: &Frame, wide: f64) {
        let (deep, wood) = (0.22, self.random.board(0.12));
        self.block(frame, "wall shelf", v(wide, deep, 0.025), v(0.0, -0.5 * deep, 0.0), wood);
        for side in [-1.0, 1.0] {
            let place = v(side * 0.36 * wide, -0.5 * deep, -0.02);
            self.block(frame, "bracket of the shelf", v(0.02, deep - 0.04, 0.02), place, plain(STEEL));
        }
        self.bay(&frame.at(v(-0.5 * wide, 0.0, 0.025), 0.0), wide, deep - 0.02, 0.33);
    }

    fn clutter(&mut self, frame: &Frame, wide: f64, light: &RoomLight) {
        self.workplace(frame, wide, 0.7, light);
        let side = if self.random.chance(0.5) { 1.0 } else { -1.0 };
        let turn = self.random.within(-20.0, 20.0);
        let sheets = self.random.count(1, 4);
        self.papers(&frame.at(v(side * (0.5 * wide - 0.19), -0.14, 0.0), turn), sheets);
        let pens = frame.at(v(-side * 0.36, 0.2, 0.0), 0.0);
        let cup = plain(self.random.strong());
        let profile = [(0.001, 0.0), (0.04, 0.0), (0.04, 0.1), (0.037, 0.1), (0.037, 0.005), (0.001, 0.005)];
        let form = crate::generate::form::Form::lathe(&profile, 24);
        self.mesh(&pens, "pen cup", form, DVec3::ZERO, DVec3::ZERO, cup);
        for k in 0..6 {
            let lean = DVec2::from_angle(f64::from(k) * 1.05) * 0.036;
            let foot = lean.extend(0.0) * -0.5 + v(0.0, 0.0, 0.006);
            let tip = lean.extend(self.random.within(0.14, 0.18));
            let paint = plain(self.random.strong());
            self.rod(&pens, "pen", 0.004, [foot, tip], paint);
        }
        let pen = plain(self.random.strong());
        let start = v(side * (0.5 * wide - 0.32), -0.26, 0.005);
        self.rod(frame, "pen", 0.0045, [start, start + v(0.05, 0.13, 0.0)], pen);
    }
}

pub(crate) fn desk(set: &mut Set) -> Plan {
    let size = v(set.random.within(3.2, 4.4), set.random.within(3.4, 4.4), set.random.within(2.4, 2.8));
    let mut shell = Shell::new(size);
    let half = 0.5 * size;
    let behind = set.random.chance(0.4);
    let sill = set.random.within(0.95, 1.1);
    if behind {
        let pane = DVec2::new(set.random.within(1.1, 1.6), size.z - sill - 0.3);
        shell.walls[0].windows.push(Window { x: set.random.within(-0.3, 0.3), sill, size: pane });
    } else {
        let wall = if set.random.chance(0.5) { 1 } else { 2 };
        let pane = DVec2::new(set.random.within(1.0, 1.5), size.z - sill - 0.35);
        shell.walls[wall].windows.push(Window { x: set.random.within(-0.3, 0.3), sill, size: pane });
    }
    set.enclose(&shell);
    let light = set.room_light(&shell);
    set.outside(&shell, 3.0);

    let (wide, deep) = (set.random.within(1.3, 1.75), 0.7);
    let wall = shell.walls[0].frame;
    // Curtains hang between the desk and the wall.
    let gap = if behind { 0.27 } else { 0.02 };
    let centre = wall.at(v(0.0, -gap - 0.5 * deep, 0.0), 0.0);
    let wood = set.random.board(0.17);
    set.table(&centre, "desk", v(wide, deep, 0.74), wood);
    set.clutter(&centre.at(v(0.0, 0.0, 0.74), 0.0), wide, &light);
    if !behind {
        match set.random.count(0, 2) {
            0 => {
                let board = DVec2::new(set.random.within(0.7, 1.2), set.random.within(0.5, 0.75));
                let x = set.random_shift(0.2);
                set.pinboard(&wall.at(v(x, 0.0, 1.62), 0.0), board);
            }
            1 => {
                let shelf = set.random.within(1.0, 1.5);
                set.wall_shelf(&wall.at(v(0.0, 0.0, 1.42), 0.0), shelf);
            }
            _ => {
                for x in [-0.42, 0.42] {
                    let extent = DVec2::new(set.random.within(0.4, 0.7), set.random.within(0.4, 0.7));
                    set.picture(&wall.at(v(x, 0.0, 1.66), 0.0), extent);
                }
            }
        }
    }
    // Beside the desk: a shelf, a plant or a lamp on either side.
    for side in [-1.0, 1.0] {
        let room = half.x - 0.5 * wide - 0.1;
        let x = side * (0.5 * wide + 0.08 + 0.5 * room);
        let (spot, pick) = (wall.at(v(x, -gap, 0.0), 0.0), set.random.count(0, 3));
        if pick == 0 && room > 0.6 && !behind {
            let tall = set.random.within(1.3, 2.1);
            set.bookcase(&spot, v((room - 0.12).min(1.0), 0.3, tall));
        } else if pick == 1 && room > 0.55 {
            set.sideboard(&spot, v((room - 0.1).min(0.9), 0.4, 0.6));
            let tall = set.random.within(0.3, 0.5);
            set.potted(&spot.at(v(0.0, -0.2, 0.6), 0.0), tall);
        } else if pick == 2 && room > 0.5 {
            set.floor_lamp(&spot.at(v(0.0, -0.28, 0.0), 0.0), light.evening);
        } else if room > 0.5 {
            let tall = set.random.within(0.8, 1.2);
            set.potted(&spot.at(v(0.0, -0.32, 0.0), 0.0), tall);
        }
    }
    let chair = centre.at(v(set.random_shift(0.3), -0.62, 0.0), 0.0);
    let turn = set.random.within(140.0, 220.0);
    if set.random.chance(0.6) {
        set.office_chair(&chair.at(DVec3::ZERO, turn));
    } else {
        let (frame, seat) = (set.random.board(0.1), set.random.fabric(0.03));
        set.chair(&chair.at(DVec3::ZERO, turn), frame, seat);
    }
    if set.random.chance(0.6) {
        let carpet = DVec2::new(set.random.within(1.2, 1.8), set.random.within(0.8, 1.1));
        set.carpet(&Frame::new(v(0.0, -0.5 * half.y, 0.0), 0.0), carpet);
    }
    if light.evening {
        set.light(
            &centre,
            "ceiling light",
            DVec2::splat(0.4),
            v(0.0, -0.6, size.z - 0.01),
            [1.0, 0.92, 0.8],
            0.9,
        );
    }
    let target = centre.point(v(0.0, 0.05, 0.92));
    set.bend_leaves(&shell);
    let draw = move |random: &mut Random| {
        let (middle, span) = (random.within(-105.0, -75.0), random.within(70.0, 110.0));
        let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
        let arc = Trajectory::Arc {
            target: target + v(random.within(-0.12, 0.12), 0.0, random.within(-0.05, 0.1)),
            radius: random.within(1.15, 1.75),
            height: random.within(0.42, 0.85),
            from: middle - 0.5 * sign * span,
            to: middle + 0.5 * sign * span,
        };
        by_hand(random, arc)
    };
    Plan {
        sky: light.sky,
        sun: light.sun,
        wish: Wish { field_of_view: [56.0, 68.0], coverage: 0.96, open: 0.6 },
        draw: Box::new(draw),
    }
}
