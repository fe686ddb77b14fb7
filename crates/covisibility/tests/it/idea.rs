use crate::sets::Set;
use covisibility::{Settings, neighbors};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Intrinsics};

/// Depth of the wall in both views.
const WALL: f32 = 4.0;

const SETTINGS: Settings = Settings { k: 4, radius: 3.0, tolerance: 0.05 };

/// Views A and B, side by side before a wall, every fourth pixel of every fourth row lifted to it, but for what `lift_a` and `lift_b`
/// make of column and row.
fn scene(lift_a: impl Fn(usize, usize) -> f32, lift_b: impl Fn(usize, usize) -> f32) -> Set {
    let lens = Intrinsics { fx: 64.0, fy: 64.0, cx: 32.0, cy: 32.0, width: 64, height: 64 };
    let camera = |x: f64| Camera::new(lens, DMat3::IDENTITY, DVec3::new(-x, 0.0, 0.0)).unwrap();
    let mut set = Set { cameras: vec![camera(0.0), camera(1.0)], ..Set::default() };
    for pixel in (0..64 * 64).filter(|pixel| pixel % 4 == 0 && pixel / 64 % 4 == 0) {
        set.lift(0, pixel, lift_a(pixel % 64, pixel / 64));
        set.lift(1, pixel, lift_b(pixel % 64, pixel / 64));
    }
    set
}

fn anchor(set: &Set, view: u32, column: u32, row: u32) -> usize {
    (0..set.views.len()).find(|&i| set.views[i] == view && set.pixels[i] == row * 64 + column).unwrap()
}

#[test]
fn a_point_lifted_too_near_gets_what_the_other_view_sees_behind_it() {
    let set = scene(|x, y| if (x, y) == (40, 32) { 2.0 } else { WALL }, |_, _| WALL);
    let wrong = anchor(&set, 0, 40, 32);
    let found = neighbors(&set.anchors(), &set.cameras, &SETTINGS).unwrap();
    // View B sees it 64 / 2 = 32 pixels to the left, before the wall.
    let behind = anchor(&set, 1, 8, 32);
    assert_eq!(found.row(wrong), (&[behind as u32][..], &[0.0][..]));

    // Among its neighbours in 3D that anchor is not, though all of them are on the wall.
    let positions: Vec<DVec3> = set.positions.iter().copied().map(DVec3::from).collect();
    let distance = |i: usize| positions[i].distance(positions[wrong]);
    let nearer = (0..positions.len()).filter(|&i| i != wrong && distance(i) < distance(behind)).count();
    assert!(nearer > 20, "{nearer}");

    // A right one gets the same place of the wall: 16 pixels to the left.
    let right = anchor(&set, 0, 20, 8);
    assert_eq!(found.row(right).0, [anchor(&set, 1, 4, 8) as u32]);
}

#[test]
fn a_point_behind_a_surface_does_not_get_that_surface() {
    // View B sees a pillar before the wall, view A does not.
    let set = scene(|_, _| WALL, |x, _| if x < 16 { 1.0 } else { WALL });
    let found = neighbors(&set.anchors(), &set.cameras, &SETTINGS).unwrap();
    // On the wall, hidden from B by the pillar.
    assert_eq!(found.row(anchor(&set, 0, 20, 8)).0, [0u32; 0]);
    assert_eq!(found.row(anchor(&set, 0, 32, 8)).0, [anchor(&set, 1, 16, 8) as u32]);
    // With a tolerance of three depths the pillar does not hide the wall.
    let loose = Settings { tolerance: 3.01, ..SETTINGS };
    let found = neighbors(&set.anchors(), &set.cameras, &loose).unwrap();
    assert_eq!(found.row(anchor(&set, 0, 20, 8)).0, [anchor(&set, 1, 4, 8) as u32]);
}
