//! What is written is read back: every layout.

use crate::folder::{Folder, chain};
use glam::{DMat3, DVec3, EulerRot};
use gs_scene::{Camera, DepthMap, Distortion, Image, Intrinsics, Lens, View};
use proptest::prelude::*;
use std::path::Path;
use view_data::{DatasetWriter, Layout, PictureFormat, open};

const WIDTH: usize = 24;
const HEIGHT: usize = 16;
const LAYOUTS: [Layout; 4] = [Layout::Nerfstudio, Layout::Colmap, Layout::ColmapText, Layout::Replica];

fn lens(distortion: Distortion) -> Lens {
    let intrinsics = Intrinsics { fx: 21.375, fy: 20.1, cx: 12.3, cy: 7.9, width: WIDTH, height: HEIGHT };
    Lens { intrinsics, model: distortion.into() }
}

fn view(name: &str, turn: [f64; 3], position: [f64; 3], depth: Vec<f32>) -> View {
    let axes = DMat3::from_euler(EulerRot::XYZ, turn[0], turn[1], turn[2]);
    let camera =
        Camera::from_camera_to_world(lens(Distortion::default()).intrinsics, axes, DVec3::from(position))
            .unwrap();
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT * 3).map(|i| (i * 7 % 251) as u8).collect();
    let image = Image::from_rgb8(WIDTH, HEIGHT, &pixels).unwrap();
    View::new(name, image, camera, Some(DepthMap::new(WIDTH, HEIGHT, depth).unwrap())).unwrap()
}

fn write(
    folder: &Path,
    layout: Layout,
    views: &[View],
    lens: &Lens,
) -> view_data::Result<view_data::Written> {
    let mut writer = DatasetWriter::create(folder, layout, PictureFormat::Png)?;
    views.iter().try_for_each(|view| writer.add(view, lens))?;
    writer.finish()
}

/// Depths of three kinds: none, up to 10 m, and beyond.
fn depths() -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(prop_oneof![Just(0.0f32), 0.01f32..9.9, 0.01f32..9.9, 10.5f32..1e4], WIDTH * HEIGHT)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn poses_lenses_depths_and_pictures_survive(
        poses in prop::collection::vec((prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-1e4..1e4f64)), 1..4),
        depth in depths(), k1 in -0.05..0.05f64, distorted in any::<bool>(),
    ) {
        let distortion = if distorted { Distortion { k1, k2: 0.003, k3: 0.0, p1: 1e-4, p2: -2e-4 } } else { Distortion::default() };
        let lens = lens(distortion);
        let views: Vec<View> = poses.iter().enumerate()
            .map(|(i, (turn, position))| view(&format!("v{i}"), *turn, *position, depth.clone())).collect();
        for layout in LAYOUTS {
            if layout == Layout::Replica && distorted {
                continue;
            }
            let folder = Folder::new();
            let target = folder.path("scene");
            let written = write(&target, layout, &views, &lens).unwrap();
            prop_assert_eq!(written.frames, views.len());
            let read = open(&target, None).unwrap();
            prop_assert_eq!(read.frames.len(), views.len());
            prop_assert!(read.dropped.is_empty(), "{:?}", read.dropped);
            for (frame, view) in read.frames.iter().zip(&views) {
                let camera = view.camera();
                let axes = camera.rotation().transpose();
                prop_assert!((frame.axes - axes).to_cols_array().iter().all(|v| v.abs() < 1e-9), "{layout:?}");
                // Scenes far from the origin are brought near it when they are read.
                let position = frame.position + read.offset.unwrap_or(DVec3::ZERO);
                let off = (position - camera.position()).length() / camera.position().length().max(1.0);
                prop_assert!(off < 1e-9, "{layout:?} {off}");
                prop_assert_eq!(frame.lens.intrinsics, lens.intrinsics);
                prop_assert_eq!(frame.lens.model, lens.model);
            }
            if distorted {
                continue;
            }
            let positions: Vec<usize> = (0..views.len()).collect();
            for (found, view) in read.load_views(&positions, None).unwrap().iter().zip(&views) {
                if layout != Layout::Replica {
                    prop_assert_eq!(found.image(), view.image());
                }
                let expected = view.depth().unwrap().data();
                match (layout, found.depth()) {
                    (Layout::Nerfstudio, Some(depth)) => prop_assert_eq!(depth.data(), expected),
                    (Layout::Replica, Some(depth)) => {
                        for (found, expected) in depth.data().iter().zip(expected) {
                            // Half a count, and what f32 adds; beyond 65535 counts there is none.
                            let holds = if *expected > 10.0 { *found == 0.0 } else { (found - expected).abs() < 0.5001 / 6553.5 };
                            prop_assert!(holds, "{found} for {expected}");
                        }
                        let beyond = expected.iter().filter(|z| **z > 10.0).count() * views.len();
                        prop_assert_eq!(written.depth_out_of_range, beyond as u64);
                    }
                    (Layout::Colmap | Layout::ColmapText, None) => {}
                    (layout, depth) => prop_assert!(false, "{layout:?}: {}", depth.is_some()),
                }
            }
        }
    }
}

/// A wall 4 m away, seen from three places.
fn wall(lens: &Lens) -> Vec<View> {
    (0..3).map(|i| view_of_wall(i, lens)).collect()
}

fn view_of_wall(i: usize, lens: &Lens) -> View {
    let mut view = view(&format!("wall{i}"), [0.0; 3], [0.2 * i as f64, 0.0, 0.0], vec![4.0; WIDTH * HEIGHT]);
    *view.image_mut() = Image::new(WIDTH, HEIGHT, vec![0.25; WIDTH * HEIGHT * 3]).unwrap();
    assert_eq!(lens.intrinsics.width, WIDTH);
    view
}

#[test]
fn points_of_a_colmap_model_lie_on_the_surface_and_are_seen_where_they_project() {
    let lens = lens(Distortion { k1: 0.03, ..Distortion::default() });
    for layout in [Layout::Colmap, Layout::ColmapText] {
        let folder = Folder::new();
        let target = folder.path("scene");
        write(&target, layout, &wall(&lens), &lens).unwrap();
        let read = open(&target, None).unwrap();
        let points = read.points().unwrap().expect("a model has points");
        assert!(points.len() > 100, "{}", points.len());
        for point in &points {
            assert!((point.position.z - 4.0).abs() < 1e-9, "{point:?}");
            assert!(point.observations.len() >= 2);
            assert_eq!(point.colour, Some([64; 3]));
            for seen in &point.observations {
                let camera = read.camera(seen.frame).unwrap();
                let direction = camera.to_camera(point.position);
                let expected = lens.distort(direction.truncate() / direction.z);
                assert!((seen.pixel - expected).length() < 1e-6, "{layout:?} {seen:?} {expected}");
            }
        }
        let depth = read.measured_depth().unwrap().unwrap();
        assert!((depth.p50 - 4.0).abs() < 1e-6 && (depth.p0_5 - 4.0).abs() < 1e-6);
    }
}

#[test]
fn what_cannot_be_written_is_told_and_leaves_nothing_behind() {
    let lens = lens(Distortion::default());
    let views = wall(&lens);
    let folder = Folder::new();
    let target = folder.path("scene");
    let refused = |result: view_data::Result<view_data::Written>, expected: &str| {
        let message = chain(&result.unwrap_err());
        assert!(message.contains("scene") && message.contains(expected), "{message:?} lacks {expected:?}");
    };
    for layout in LAYOUTS {
        refused(write(&target, layout, &[], &lens), "there are no frames");
        refused(
            write(&target, layout, &[views[0].clone(), views[0].clone()], &lens),
            "\"wall0\" occurs twice",
        );
    }
    let bad_name = view("a/b", [0.0; 3], [0.0; 3], vec![1.0; WIDTH * HEIGHT]);
    refused(write(&target, Layout::Nerfstudio, &[bad_name], &lens), "no plain file name");
    let distorted = Lens { model: Distortion { k1: 0.1, ..Distortion::default() }.into(), ..lens };
    refused(write(&target, Layout::Replica, &views, &distorted), "wall0 has lens distortion");
    let mut writer = DatasetWriter::create(&target, Layout::Replica, PictureFormat::Png).unwrap();
    writer.add(&views[0], &lens).unwrap();
    let other = Lens { intrinsics: Intrinsics { fx: 30.0, ..lens.intrinsics }, ..lens };
    refused(writer.add(&views[1], &other).and_then(|()| writer.finish()), "wall1 has other intrinsics");
    let left: Vec<_> =
        std::fs::read_dir(folder.path("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.is_empty(), "{left:?}");

    write(&target, Layout::Replica, &views, &lens).unwrap();
    refused(write(&target, Layout::Replica, &views, &lens), "not empty");
    write(&folder.path("scene2"), Layout::Replica, &views, &lens).unwrap();
    refused(write(&folder.path("scene3"), Layout::Replica, &views, &other), "another camera");
}

#[test]
fn what_a_killed_process_left_is_removed_and_what_a_living_one_has_stays() {
    let folder = tempfile::tempdir().unwrap();
    let left = |id: &str| {
        let left = folder.path().join(format!(".set.{id}.tmp"));
        std::fs::create_dir_all(left.join("images")).unwrap();
        std::fs::write(left.join(".lock"), b"").unwrap();
        left
    };
    let (dead, alive, foreign) = (left("4000001"), left("4000002"), left("mine"));
    let lock = gs_scene::lock_file(&alive.join(".lock")).unwrap();
    assert!(lock.is_some());
    let target = folder.path().join("set");
    let writer = DatasetWriter::create(&target, Layout::Nerfstudio, PictureFormat::Png).unwrap();
    assert!(!dead.exists() && alive.exists() && foreign.exists());
    drop(writer);
    drop(lock);
    let mut writer = DatasetWriter::create(&target, Layout::Nerfstudio, PictureFormat::Png).unwrap();
    assert!(!alive.exists());
    let lens = lens(Distortion::default());
    writer.add(&view_of_wall(0, &lens), &lens).unwrap();
    writer.finish().unwrap();
    assert!(!target.join(".lock").exists() && target.join("transforms.json").is_file());
}
