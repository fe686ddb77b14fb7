use crate::sets::Set;
use covisibility::{Anchors, Error, Settings, brute_force, neighbors};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Intrinsics};

const LENS: Intrinsics = Intrinsics { fx: 8.0, fy: 8.0, cx: 4.5, cy: 4.5, width: 9, height: 9 };
const SETTINGS: Settings = Settings { k: 20, radius: 2.0, tolerance: 0.05 };

/// Two cameras at the same place.
fn cameras() -> Vec<Camera> {
    vec![Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).unwrap(); 2]
}

/// The same of both ways.
fn error(anchors: &Anchors, settings: &Settings) -> Error {
    let found = neighbors(anchors, &cameras(), settings).unwrap_err();
    // As text, because NaN differs from itself.
    assert_eq!(found.to_string(), brute_force(anchors, &cameras(), settings).unwrap_err().to_string());
    found
}

#[test]
fn bad_anchors_are_named_by_their_index() {
    let good =
        Anchors { positions: &[[0.0, 0.0, 1.0]; 2], views: &[0, 1], pixels: &[40, 40], depths: &[1.0, 1.0] };
    for (bad, expected) in [
        (Anchors { views: &[0], ..good }, "views has 1 entries, expected 2: one per anchor"),
        (Anchors { pixels: &[], ..good }, "pixels has 0 entries, expected 2: one per anchor"),
        (Anchors { depths: &[1.0; 3], ..good }, "depths has 3 entries, expected 2: one per anchor"),
        (Anchors { views: &[0, 2], ..good }, "anchor 1 is of view 2, expected a view below 2"),
        (Anchors { pixels: &[40, 81], ..good }, "anchor 1 is pixel 81 of view 1, expected a pixel below 81"),
        (
            Anchors { positions: &[[0.0, f64::NAN, 1.0]; 2], ..good },
            "anchor 0 is at (0, NaN, 1), expected finite coordinates: drop or mend it first",
        ),
        (
            Anchors { depths: &[1.0, f32::INFINITY], ..good },
            "depth of anchor 1 is inf, expected a finite number: drop or mend it first",
        ),
    ] {
        assert_eq!(error(&bad, &SETTINGS).to_string(), expected);
        error(&bad, &Settings { k: 0, ..SETTINGS });
    }
    for radius in [-1.0, f64::NAN, f64::INFINITY] {
        let found = error(&good, &Settings { radius, ..SETTINGS }).to_string();
        assert_eq!(found, format!("radius is {radius}, expected a finite number of at least 0"));
    }
    let found = error(&good, &Settings { tolerance: -0.1, ..SETTINGS });
    assert!(matches!(found, Error::Setting { what: "tolerance", .. }));
}

#[test]
fn nothing_to_find_gives_empty_rows() {
    let none = Anchors { positions: &[], views: &[], pixels: &[], depths: &[] };
    for cameras in [&cameras()[..], &[]] {
        let found = neighbors(&none, cameras, &SETTINGS).unwrap();
        assert_eq!((found.rows(), found.starts), (0, vec![0]));
    }
    let two =
        Anchors { positions: &[[0.0, 0.0, 1.0]; 2], views: &[0, 0], pixels: &[40, 41], depths: &[1.0; 2] };
    for (cameras, settings) in [
        (&cameras()[..1], SETTINGS),
        (&cameras()[..], SETTINGS),
        (&cameras()[..], Settings { k: 0, ..SETTINGS }),
    ] {
        let found = neighbors(&two, cameras, &settings).unwrap();
        assert_eq!((found.rows(), found.row(1)), (2, (&[][..], &[][..])));
    }
}

#[test]
fn the_centre_of_a_camera_and_what_is_behind_it_are_not_seen() {
    let positions =
        [[0.0; 3], [0.0, 0.0, -1.0], [1e-320, 0.0, 0.0], [1e308; 3], [0.0, 0.0, 1.0], [0.0, 0.0, 1e300]];
    let mut set = Set { cameras: cameras(), ..Set::default() };
    for position in positions {
        set.lift(0, 40, 1.0);
        *set.positions.last_mut().unwrap() = position;
    }
    set.lift(1, 40, 1.0);
    let settings = Settings { radius: 1e300, ..SETTINGS };
    let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
    let lengths: Vec<usize> = (0..positions.len()).map(|i| found.row(i).0.len()).collect();
    // The last is in the picture, but behind what view 1 sees.
    assert_eq!(lengths, [0, 0, 0, 0, 1, 0]);
    assert_eq!(found, brute_force(&set.anchors(), &set.cameras, &settings).unwrap());
}

#[test]
fn all_anchors_in_one_pixel_are_taken_by_index() {
    let mut set = Set { cameras: cameras(), ..Set::default() };
    for i in 0..2000 {
        set.lift(i % 2, 40, 1.0);
    }
    let settings = Settings { k: 3, radius: 0.0, tolerance: 0.0 };
    let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
    assert_eq!(found.row(0), (&[1u32, 3, 5][..], &[0.0f32; 3][..]));
    assert_eq!(found.row(1999), (&[0u32, 2, 4][..], &[0.0f32; 3][..]));
}

#[test]
fn the_largest_pictures_are_searched() {
    let lens = Intrinsics { fx: 1e9, fy: 1e9, cx: 1e9, cy: 0.5, width: 1 << 31, height: 1 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
    let mut set = Set { cameras: vec![camera; 2], ..Set::default() };
    for pixel in [0, 5, 1_000_000_000, (1 << 31) - 1] {
        set.lift(0, pixel, 1.0);
        set.lift(1, pixel, 1.0);
    }
    for radius in [1.0, 10.0, 1e20] {
        let settings = Settings { radius, ..SETTINGS };
        let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
        assert_eq!(found, brute_force(&set.anchors(), &set.cameras, &settings).unwrap());
        assert_eq!(found.row(6).0[0], 7);
    }
}

#[test]
fn the_nearest_surface_in_depth_tolerance_does_not_hide() {
    let mut set = Set { cameras: cameras(), ..Set::default() };
    set.lift(0, 40, 1.25);
    set.lift(1, 40, 1.0);
    for (tolerance, expected) in [(0.25, 1), (0.2499, 0), (f64::MAX, 1)] {
        let settings = Settings { tolerance, ..SETTINGS };
        let found = neighbors(&set.anchors(), &set.cameras, &settings).unwrap();
        assert_eq!(found.row(0).0.len(), expected, "{tolerance}");
        assert_eq!(found.row(1).0, [0]);
    }
}
