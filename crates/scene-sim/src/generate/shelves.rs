//! Shelves along a wall; the camera walks past them.

use crate::Trajectory;
use crate::generate::Plan;
use crate::generate::set::{Frame, Set};
use crate::generate::shell::{Shell, Window};
use crate::generate::view::{Wish, by_hand};
use crate::random::Random;
use crate::stage::{plain, v};
use glam::{DVec2, DVec3};

impl Set {
    /// A ladder that leans at a shelf: its feet at the origin, its head `deep` behind.
    fn ladder(&mut self, frame: &Frame, tall: f64, deep: f64) {
        let wood = self.random.timber(0.06);
        for side in [-1.0, 1.0] {
            let x = 0.2 * side;
            self.rod(frame, "rail of the ladder", 0.02, [v(x, 0.0, 0.004), v(x, deep, tall)], wood);
        }
        let rungs = (tall / 0.28) as u32;
        for k in 1..rungs {
            let t = f64::from(k) / f64::from(rungs);
            let place = v(0.0, t * deep, t * tall);
            let arm = v(0.2, 0.0, 0.0);
            self.rod(frame, "rung of the ladder", 0.014, [place - arm, place + arm], wood);
        }
    }
}

pub(crate) fn shelves(set: &mut Set) -> Plan {
    let size = v(set.random.within(4.6, 6.4), set.random.within(2.9, 3.8), set.random.within(2.5, 2.9));
    let mut shell = Shell::new(size);
    let half = 0.5 * size;
    let bright = if set.random.chance(0.5) { 1 } else { 2 };
    let pane = DVec2::new((size.y - 1.7).min(1.3), 1.4);
    shell.walls[bright].windows.push(Window { x: 0.0, sill: 0.9, size: pane });
    let front = Window { x: 0.0, sill: 0.9, size: DVec2::new(1.5, 1.3) };
    shell.walls[3].windows.push(front);
    set.enclose(&shell);
    let light = set.room_light(&shell);
    set.outside(&shell, 3.0);
    let back = shell.walls[0].frame;
    let (mut x, deep) = (-half.x + set.random.within(0.05, 0.5), set.random.within(0.27, 0.36));
    let one_height = set.random.chance(0.5);
    let height = set.random.within(1.7, size.z - 0.25);
    let mut tall = height;
    while half.x - x > 0.75 {
        if !one_height {
            tall = set.random.within(1.2, size.z - 0.25);
        }
        if set.random.chance(0.16) {
            // A gap with a plant and a picture.
            let spot = back.at(v(x + 0.36, 0.0, 0.0), 0.0);
            let plant = set.random.within(0.7, 1.2);
            set.potted(&spot.at(v(0.0, -0.36, 0.0), 0.0), plant);
            let picture = DVec2::new(0.42, set.random.within(0.4, 0.6));
            set.picture(&spot.at(v(0.0, 0.0, 1.65), 0.0), picture);
            x += 0.74;
            continue;
        }
        let wide = set.random.within(0.72, 1.25).min(half.x - x - 0.03);
        let spot = back.at(v(x + 0.5 * wide, -0.015, 0.0), 0.0);
        set.bookcase(&spot, v(wide, deep, tall));
        let top = spot.at(v(0.0, -0.5 * deep, tall), 0.0);
        if size.z - tall > 0.45 {
            match set.random.count(0, 3) {
                0 => {
                    let vase = (size.z - tall - 0.1).min(0.34);
                    set.vase(&top, vase);
                }
                1 => {
                    let plant = (size.z - tall - 0.06).min(0.45);
                    set.potted(&top, plant);
                }
                2 => {
                    set.pile_of_books(&top, 3, 0.26);
                }
                _ => {}
            }
        }
        x += wide + 0.004;
    }
    let aside = set.random.within(-0.5, 0.5) * half.x;
    if set.random.chance(0.6) {
        let lean = (0.26, (height * 0.95).min(2.0));
        set.ladder(&back.at(v(aside, -deep - lean.0 - 0.04, 0.0), 0.0), lean.1, lean.0);
    }
    if set.random.chance(0.6) {
        let (wood, seat) = (set.random.board(0.1), set.random.fabric(0.04));
        let turn = set.random.within(150.0, 230.0);
        set.chair(&back.at(v(-aside - 0.4, -deep - 0.5, 0.0), turn), wood, seat);
    }
    for side in [-1.0, 1.0] {
        let place = v(side * set.random.within(0.2, 0.8) * half.x, -deep - 0.25, 0.0);
        if (place.x - aside).abs() > 0.5 && (place.x + aside + 0.4).abs() > 0.5 {
            let count = set.random.count(3, 9);
            set.pile_of_books(&back.at(place, 0.0), count, 0.27);
        }
    }
    let runner = DVec2::new(size.x * 0.6, 0.8);
    set.carpet(&Frame::new(v(0.0, half.y - deep - 1.25, 0.0), 0.0), runner);
    let world = Frame::new(DVec3::ZERO, 0.0);
    for side in [-1.0, 1.0] {
        let place = v(side * 0.5 * half.x, half.y - deep - 0.9, size.z - 0.05);
        set.block(&world, "ceiling lamp", v(0.9, 0.16, 0.05), place, plain([0.92; 3]));
        if light.evening {
            let below = place - v(0.0, 0.0, 0.003);
            set.light(&world, "ceiling light", DVec2::new(0.84, 0.12), below, [1.0, 0.94, 0.84], 0.7);
        }
    }
    set.bend_leaves(&shell);
    let draw = move |random: &mut Random| {
        let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
        let y = half.y - deep - random.within(1.35, 1.9).min(size.y - deep - 0.5);
        let (reach, high) = (half.x - random.within(0.55, 1.3), random.within(1.15, 1.6));
        let (drift, lead) = (random.within(-0.2, 0.2), random.within(0.5, 1.0));
        let places = [-1.0, -0.3, 0.3, 1.0].map(|k| v(sign * k * reach, y + drift * k, high));
        let targets = [-1.0, -0.3, 0.3, 1.0].map(|k| v(sign * k * reach * lead, half.y, high - 0.2));
        by_hand(random, Trajectory::Through { places: places.to_vec(), targets: targets.to_vec() })
    };
    Plan {
        sky: light.sky,
        sun: light.sun,
        wish: Wish { field_of_view: [62.0, 74.0], coverage: 0.96, open: 0.7 },
        draw: Box::new(draw),
    }
}
