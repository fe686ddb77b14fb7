//! A dwelling of four rooms around a corner post, and the path of somebody who walks through all of them, twice.

use crate::generate::palette::BLACK;
use crate::generate::room::{Piece, openings};
use crate::generate::set::{Frame, HAIR, Set};
use crate::generate::shell::{RoomLight, Shell};
use crate::random::Random;
use crate::stage::{plain, v};
use crate::{Pattern, Photographs, Scene, Trajectory};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Half the width of the dwelling, metres.
const HALF: f64 = 4.6;
/// Distance of the doorways, and of the path, from the middle.
const DOORWAY: f64 = 2.3;
/// Width and height of a doorway.
const OPENING: DVec2 = DVec2::new(1.3, 2.1);
/// Thickness of the walls between the rooms.
const THICK: f64 = 0.12;
/// Furniture stays this far from the walls between the rooms, metres: the path bends there.
const CLEAR: f64 = 0.4;
/// Rounds of the path: the second shows what the first does.
const ROUNDS: u32 = 2;
/// Places of the path per round.
const PLACES: u32 = 24;

impl Set {
    /// A wall from the middle outwards along the frame's x, with a doorway and pictures on both sides.
    fn partition(&mut self, frame: &Frame, height: f64, paper: Pattern) {
        let (left, right) = (DOORWAY - 0.5 * OPENING.x, DOORWAY + 0.5 * OPENING.x);
        let inner = v(left - 0.5 * THICK, THICK, height - 2.0 * HAIR);
        let outer = v(HALF - right - HAIR, THICK, height - 2.0 * HAIR);
        self.block(frame, "partition", inner, v(0.5 * (left + 0.5 * THICK), 0.0, HAIR), paper);
        self.block(frame, "partition", outer, v(0.5 * (right + HALF - HAIR), 0.0, HAIR), paper);
        let lintel = v(OPENING.x, THICK, height - OPENING.y - HAIR);
        self.block(frame, "lintel", lintel, v(DOORWAY, 0.0, OPENING.y), paper);
        let trim = plain(self.random.near([0.9, 0.89, 0.86], 0.05));
        for x in [left - 0.03, right + 0.03] {
            self.block(frame, "door frame", v(0.06, THICK + 0.03, OPENING.y), v(x, 0.0, HAIR), trim);
        }
        for (x, wide) in [(0.5 * left, left - 0.5), (0.5 * (right + HALF), HALF - right - 0.7)] {
            for turn in [0.0, 180.0] {
                let size = DVec2::new(self.random.within(0.5, 0.9) * wide, self.random.within(0.5, 1.0));
                let z = self.random.within(1.35, 1.55);
                let side = if turn == 0.0 { -0.5 * THICK } else { 0.5 * THICK };
                self.picture(&frame.at(v(x, side, z), turn), size);
            }
        }
    }

    /// Furniture along the outer walls, in every room.
    fn furnish(&mut self, shell: &Shell, light: &RoomLight) {
        let mut pieces = Vec::new();
        for _ in 0..4 {
            let mut more = vec![
                Piece::Sofa,
                Piece::Bookcase,
                Piece::Sideboard,
                Piece::Plant,
                Piece::Bookcase,
                Piece::Armchair,
                Piece::Desk,
                Piece::FloorLamp,
            ];
            self.random.shuffle(&mut more);
            pieces.append(&mut more);
        }
        let height = shell.size.z;
        for (index, wall) in shell.walls.iter().enumerate() {
            // Two walls go into the corners, the other two stop before what stands there.
            let end = if index % 3 == 0 { HALF - 0.15 } else { HALF - 1.3 };
            for (from, to) in [(-end, -CLEAR), (CLEAR, end)] {
                self.line(wall, height, from, to, &mut pieces, light);
            }
        }
    }
}

/// The way through all rooms, `ROUNDS` times, looking ahead and to the outer walls in turn.
fn path(random: &mut Random) -> Trajectory {
    let start = random.within(0.0, TAU);
    let phase = random.within(0.0, TAU);
    let (mut places, mut targets) = (Vec::new(), Vec::new());
    for k in 0..=ROUNDS * PLACES {
        let angle = start + TAU * f64::from(k) / f64::from(PLACES);
        let high = if k <= PLACES { 1.55 } else { 1.45 };
        let place = DVec2::from_angle(angle) * DOORWAY;
        // Ahead is a quarter turn from outwards; the eyes wander between.
        let wander = 0.55 + 0.4 * (4.0 * angle + phase).sin();
        let sight = DVec2::from_angle(angle + wander * 0.25 * TAU) * 3.0;
        places.push(place.extend(high));
        targets.push((place + sight).extend(1.1));
    }
    let path = Trajectory::Through { places, targets };
    Trajectory::Handheld { path: Box::new(path), sway: 0.012, turn: 0.8, seed: u64::from(random.bits()) }
}

/// A dwelling of four rooms, with a path through all of them that goes round twice. The same seed gives the same scene.
///
/// Every seed has other walls, windows, furniture and pictures, and the same ground plan. The path passes the doorways in their middle.
#[must_use]
pub fn generate_dwelling(seed: u64) -> Scene {
    let mut set = Set::new(Random::new(seed, 0x6477_6500));
    let mut shell = Shell::new(v(2.0 * HALF, 2.0 * HALF, set.random.within(2.5, 2.8)));
    openings(&mut set.random, &mut shell, 2);
    for wall in &mut shell.walls {
        // Where the walls between the rooms meet the outer ones there is no room for a window or a door.
        wall.windows.retain(|window| window.x.abs() > 0.5 * window.size.x + CLEAR);
    }
    set.enclose(&shell);
    let mut light = set.room_light(&shell);
    // It takes most of the time, and pictures that test a map need no soft corners.
    light.sky.occlusion = None;
    let floor = set.random.pick(&[0.5, 3.2]);
    set.outside(&shell, floor);
    set.furnish(&shell, &light);
    for quarter in 0..4 {
        let paper = set.random.wallpaper();
        set.partition(&Frame::new(DVec3::ZERO, 90.0 * f64::from(quarter)), shell.size.z, paper);
    }
    let size = v(THICK - HAIR, THICK - HAIR, shell.size.z - 2.0 * HAIR);
    set.block(&Frame::new(DVec3::ZERO, 0.0), "post", size, v(0.0, 0.0, HAIR), plain(BLACK));
    set.bend_leaves(&shell);
    let path = path(&mut set.random);
    let Set { primitives, meshes, lamps, .. } = set;
    let photographs = Photographs {
        width: 480,
        height: 320,
        field_of_view: 72.0,
        path,
        count: 300,
        samples: 4,
        distortion: None,
        aperture: None,
        motion_blur: None,
        rolling_shutter: None,
        exposure: None,
        noise: None,
        pose_error: None,
    };
    Scene {
        primitives,
        meshes,
        lamps,
        sun: light.sun,
        photographs: Some(photographs),
        ..Scene::under(light.sky)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Traced, photograph};

    #[test]
    fn the_path_goes_round_twice_and_sees_the_rooms() {
        for seed in [0, 1, 2] {
            let scene = generate_dwelling(seed);
            let mut walk = scene.photographs.clone().unwrap();
            (walk.width, walk.height, walk.samples, walk.count) = (24, 16, 1, 2 * 36 + 1);
            let traced = Traced::new(&scene).unwrap();
            assert!(traced.dropped().is_empty());
            let views: Vec<_> =
                (0..walk.count).map(|i| photograph(&traced, &walk, i, 0).unwrap().view).collect();
            for (i, view) in views.iter().enumerate() {
                let depth = view.depth().unwrap();
                // A window may show the sky.
                assert!(depth.coverage() > 0.6, "seed {seed}, frame {i}: {}", depth.coverage());
                let nearest = depth.data().iter().copied().filter(|z| *z > 0.0).fold(f32::INFINITY, f32::min);
                assert!(nearest > 0.15, "seed {seed}, frame {i}: {nearest}");
            }
            for i in 0..36 {
                let (a, b) = (views[i].camera(), views[i + 36].camera());
                assert!(a.position().distance(b.position()) < 0.25, "seed {seed}, frame {i}");
                assert!(a.forward().dot(b.forward()) > 0.95, "seed {seed}, frame {i}");
            }
        }
    }
}
