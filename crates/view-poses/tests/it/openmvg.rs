//! openMVG-rs on simulated photographs.

use crate::scenes::{HEIGHT, Set, WIDTH, camera, courtyard, picture, views};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::Camera;
use image::RgbImage;
use scene_sim::{Kind, Traced, generate, lens, render_view, varied_cameras, varied_scene};
use view_data::{Dataset, Format, open};
use view_poses::{Doubt, EngineChoice, Error, Estimate, Settings, estimate_poses, is_made_from};

const SETTINGS: Settings = Settings {
    engine: EngineChoice::OpenMvg,
    cut: view_poses::Cut { frames: 40, from: None, to: None },
    keep_all: false,
    undistort: false,
    seed: 0,
};

fn estimate(set: &Set) -> view_poses::Result<Estimate> {
    estimate_poses(&set.photographs(), &set.beside("scene"), &SETTINGS, &|_| ())
}

/// Angles between the given and the found directions of pairs of cameras, degrees; worst.
fn worst_turn(found: &Dataset) -> f64 {
    let number = |name: &str| name.trim_start_matches("view").parse::<usize>().unwrap();
    let given: Vec<DMat3> = found.frames.iter().map(|frame| camera(number(&frame.name)).rotation()).collect();
    let mut worst: f64 = 0.0;
    for (i, a) in found.frames.iter().enumerate() {
        for (j, b) in found.frames.iter().enumerate() {
            let expected = given[j] * given[i].transpose();
            let between = b.axes.transpose() * a.axes * expected.transpose();
            let angle = DQuat::from_mat3(&between).normalize();
            worst = worst.max(2.0 * angle.w.abs().min(1.0).acos().to_degrees());
        }
    }
    worst
}

#[test]
fn photographs_of_a_scene_get_their_poses_in_both_layouts() {
    let set = Set::of_views();
    let found = estimate(&set).unwrap();
    assert_eq!((found.verdict.registered, found.verdict.photographs), (8, 8));
    assert_eq!(found.verdict.doubts, []);
    assert!(found.not_used.is_empty());
    let given = lens(WIDTH, HEIGHT, 62.0);
    let focal = found.verdict.focal_lengths[0].unwrap() * WIDTH as f64 / given.fx;
    assert!((focal - 1.0).abs() < 0.05, "focal length off by {focal}");
    let [nerfstudio, colmap] = [Format::Nerfstudio, Format::Colmap].map(|format| {
        let dataset = open(&set.beside("scene"), Some(format)).unwrap();
        assert_eq!((dataset.frames.len(), dataset.dropped.len()), (8, 0), "{:?}", dataset.dropped);
        dataset
    });
    assert!(worst_turn(&nerfstudio) < 1.0, "{}", worst_turn(&nerfstudio));
    for (a, b) in nerfstudio.frames.iter().zip(&colmap.frames) {
        assert_eq!(a.name, b.name);
        assert!((a.position - b.position).length() < 1e-9 && (a.axes.x_axis - b.axes.x_axis).length() < 1e-9);
        // Up is up.
        assert!(-a.axes.y_axis.z > 0.8 && a.axes.x_axis.z.abs() < 0.1, "{:?}", a.axes);
        assert!((a.lens.intrinsics.fx - b.lens.intrinsics.fx).abs() < 1e-9);
    }
    // Every point projects to where it was seen.
    let points = colmap.points().unwrap().unwrap();
    assert!(points.len() > 50);
    for seen in points.iter().flat_map(|point| point.observations.iter().map(move |seen| (point, seen))) {
        let (point, seen) = seen;
        let frame = &colmap.frames[seen.frame];
        let at = frame.camera().unwrap().to_camera(point.position);
        let pixel = frame.lens.distort(at.truncate() / at.z);
        assert!((pixel - seen.pixel).length() < 8.0, "{pixel} {}", seen.pixel);
    }
    // The unit is the distance of the points.
    let depth = nerfstudio.depth_percentiles.unwrap();
    assert!((0.7..1.2).contains(&depth.p50), "{depth:?}");
    assert!(!set.beside("scene/work").exists());

    assert!(is_made_from(&set.beside("scene"), &set.photographs(), &SETTINGS));
    assert!(!is_made_from(
        &set.beside("scene"),
        &set.photographs(),
        &Settings { keep_all: true, ..SETTINGS }
    ));
    set.add("more.png", &picture(&views()[0]));
    assert!(!is_made_from(&set.beside("scene"), &set.photographs(), &SETTINGS));
    let occupied = estimate(&set).unwrap_err();
    assert!(matches!(&occupied, Error::Data(_)), "{occupied}");
}

#[test]
fn the_same_photographs_give_the_same_bytes() {
    let record = || {
        let set = Set::of_views();
        estimate(&set).unwrap();
        std::fs::read(set.beside("scene/sparse/0/points3D.bin")).unwrap()
    };
    assert_eq!(record(), record());
}

/// Asserts that there is no scene, and that the message holds every part.
fn refused(set: &Set, parts: &[&str]) {
    let error = estimate(set).unwrap_err();
    let message = error.to_string();
    assert!(parts.iter().all(|part| message.contains(part)), "no {parts:?} in: {message}");
    assert!(!set.beside("scene").exists());
}

#[test]
fn unrelated_photographs_are_refused() {
    let set = Set::new();
    for seed in 0..6 {
        let scene = Traced::new(&varied_scene(seed)).unwrap();
        let camera = varied_cameras(seed, WIDTH, HEIGHT, 2).unwrap()[0];
        let view = render_view(&scene, &camera, 4, format!("view{seed}"), seed).unwrap();
        set.add(&format!("view{seed}.png"), &picture(&view));
    }
    refused(&set, &["none of the 6 photographs overlap", "expected photographs of one scene"]);
}

#[test]
fn a_white_wall_is_refused() {
    let set = Set::new();
    for i in 0..6u32 {
        let wall = |x: u32, y: u32| image::Rgb([200 + ((x / 80 + y / 60 + i * 7) % 40) as u8; 3]);
        set.add(&format!("wall{i}.png"), &RgbImage::from_fn(240, 180, wall));
    }
    refused(&set, &["none of the", "photographs overlap", "texture"]);
}

#[test]
fn a_camera_that_only_turns_is_refused() {
    let set = Set::new();
    for i in 0..8 {
        let position = DVec3::new(0.4, -3.4, 1.7);
        let angle = (60.0 + 6.0 * f64::from(i)).to_radians();
        let target = position + DVec3::new(angle.cos(), angle.sin(), -0.15);
        let camera = Camera::looking_at(lens(WIDTH, HEIGHT, 62.0), position, target, DVec3::Z).unwrap();
        let view = render_view(courtyard(), &camera, 4, format!("view{i}"), 0).unwrap();
        set.add(&format!("view{i}.png"), &picture(&view));
    }
    let error = estimate(&set).unwrap_err();
    assert!(matches!(error, Error::Lost { .. } | Error::NothingMatches { .. }), "{error}");
    assert!(!set.beside("scene").exists());
}

#[test]
fn of_two_scenes_one_is_taken_and_the_other_named() {
    let set = Set::of_views();
    let scene = Traced::new(&generate(Kind::Desk, 3)).unwrap();
    for (i, camera) in varied_cameras(3, WIDTH, HEIGHT, 5).unwrap().iter().enumerate() {
        let view = render_view(&scene, camera, 4, format!("other{i}"), 0).unwrap();
        set.add(&format!("other{i}.png"), &picture(&view));
    }
    let found = estimate(&set).unwrap();
    assert!(found.verdict.doubts.iter().any(|doubt| matches!(doubt, Doubt::Share { .. })), "{found:?}");
    assert!(found.advice.is_some() && found.not_used.len() >= 5, "{found:?}");
    let dataset = open(&set.beside("scene"), None).unwrap();
    let scenes = |name: &str| dataset.frames.iter().filter(|frame| frame.name.starts_with(name)).count();
    assert!(scenes("view") == 0 || scenes("other") == 0, "both are in one scene");
}
