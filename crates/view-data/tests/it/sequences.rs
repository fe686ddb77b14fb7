//! Replica, TUM RGB-D and ScanNet: conventions, what is paired with what, the ledger, and every rule that can be broken.

use crate::folder::{Folder, chain};
use crate::samples;
use glam::{DMat3, DVec2, DVec3};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use view_data::{
    Dataset, Format, LensModel, open, open_all, open_replica, open_scannet, open_tum, open_tum_within,
};

fn sample(format: Format, scene: &str) -> (Folder, PathBuf) {
    let folder = Folder::new();
    samples::write(format, "", folder.root());
    let path = folder.root().join(scene);
    assert_eq!(open(&path, None).unwrap().format, format);
    (folder, path)
}

fn listed(dataset: &Dataset) -> Vec<(&str, &str)> {
    dataset.dropped.iter().map(|entry| (&*entry.key, &*entry.reason)).collect()
}

#[track_caller]
fn check_error(opened: view_data::Result<Dataset>, expected: &str) {
    let message = chain(&opened.unwrap_err());
    assert!(message.contains(expected), "{message:?} does not contain {expected:?}");
}

#[test]
fn replica_has_whole_pixel_centres_opencv_poses_and_depth_up_to_65534() {
    let (folder, path) = sample(Format::Replica, "room0");
    let dataset = open_replica(&path).unwrap();
    assert_eq!((&*dataset.name, dataset.frames.len(), dataset.dropped.len()), ("room0", 5, 0));
    let lens = dataset.frames[0].lens.intrinsics;
    // 599.5 of 1200 pixels is the middle where centres are whole numbers; ours are at +0.5.
    assert_eq!((lens.cx, lens.cy, lens.width, lens.height), (32.0, 24.0, 64, 48));
    let camera = dataset.camera(3).unwrap();
    assert_eq!((camera.position(), camera.forward()), (DVec3::new(3.0, 0.0, 0.0), DVec3::Z));
    assert_eq!(dataset.frames[3].name, "frame000003");
    let view = dataset.load_views(&[3], None).unwrap().remove(0);
    let depth = view.depth().unwrap().data();
    assert_eq!((depth[0], depth[1]), (0.0, 0.0));
    assert!((depth[2] - 2.0).abs() < 1e-6);
    // The camera may lie in the scene's own folder, without the nesting.
    std::fs::remove_file(folder.root().join("cam_params.json")).unwrap();
    check_error(
        open_replica(&path),
        "room0/cam_params.json: is not there: the camera is not known; or put it",
    );
    let flat = r#"{"w": 64, "h": 48, "fx": 60, "fy": 61, "cx": 31.5, "cy": 23.5, "scale": 1000}"#;
    samples::text(&path.join("cam_params.json"), flat);
    assert_eq!(open_replica(&path).unwrap().frames[0].lens.intrinsics.fy, 61.0);
    assert_eq!(open_all(folder.root(), None).unwrap().scenes.len(), 1);
}

#[test]
fn replica_pairs_by_number_and_lists_what_is_left() {
    let (_folder, path) = sample(Format::Replica, "room0");
    std::fs::remove_file(path.join("results/frame000001.jpg")).unwrap();
    std::fs::remove_file(path.join("results/depth000003.png")).unwrap();
    samples::picture(&path.join("results/frame000007.jpg"), 64, 48);
    samples::picture(&path.join("results/notes.png"), 64, 48);
    let dataset = open_replica(&path).unwrap();
    assert_eq!((dataset.frames.len(), dataset.present()), (5, vec![0, 2, 3, 4]));
    assert_eq!(dataset.frames[2].position, DVec3::new(2.0, 0.0, 0.0));
    let found = listed(&dataset);
    assert_eq!(found.len(), 3);
    assert_eq!(found[0], ("frame000007.jpg", "no pose: traj.txt has 5 lines"));
    assert!(found[1].0 == "frame000001" && found[1].1.starts_with("picture missing"));
    assert_eq!(found[2], ("depth", "no depth for 1 of 5 frames, the first is frame000003"));
}

#[test]
fn replica_names_every_broken_rule() {
    let (folder, path) = sample(Format::Replica, "room0");
    let with = |line: &str| {
        samples::text(&path.join("traj.txt"), &format!("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n{line}\n"));
        open_replica(&path)
    };
    check_error(with("1 0 0"), "traj.txt: line 2: 3 words, expected 16 numbers");
    check_error(with("1 0 0 x 0 1 0 0 0 0 1 0 0 0 0 1"), "line 2: a number of the matrix is \"x\"");
    check_error(with("1 0 0 nan 0 1 0 0 0 0 1 0 0 0 0 1"), "line 2: a number of the matrix is NaN");
    check_error(with("2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"), "line 2: pose holds no rotation");
    check_error(with("-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"), "line 2: pose mirrors the scene");
    check_error(
        with("1 0 0 0 0 1 0 0 0 0 1 0 5 0 0 1"),
        "line 2: last row of the matrix is [5.0, 0.0, 0.0, 1.0]",
    );
    samples::text(&path.join("traj.txt"), "\n");
    check_error(open_replica(&path), "traj.txt: has no frames with a pose");
    let with = |camera: &str| {
        samples::text(&folder.root().join("cam_params.json"), camera);
        open_replica(&path)
    };
    check_error(with("{}"), "cam_params.json: key w is missing");
    let all = |scale: &str, cx: &str| {
        format!(
            r#"{{"camera": {{"w": 64, "h": 48, "fx": 60, "fy": 60, "cx": {cx}, "cy": 23.5, "scale": {scale}}}}}"#
        )
    };
    check_error(with(&all("0", "31.5")), "scale is 0, expected counts of depth per metre");
    check_error(with(&all("1", "599.5")), "principal point is [599.5, 23.5], outside of the 64x48 picture");
    check_error(with("{"), "cam_params.json: not valid JSON");
}

#[test]
fn tum_takes_what_is_nearest_in_time_and_the_known_camera() {
    let (_folder, path) = sample(Format::Tum, "rgbd_dataset_freiburg3_desk");
    // A picture between poses, one whose file is gone, a depth picture too late.
    let rgb = path.join("rgb.txt");
    let list = std::fs::read_to_string(&rgb).unwrap() + "100.2500 rgb/late.png\n100.3010 rgb/gone.png\n";
    std::fs::write(&rgb, list).unwrap();
    let dataset = open_tum(&path).unwrap();
    let names: Vec<_> = dataset.frames.iter().map(|frame| &*frame.name).collect();
    assert_eq!(names, ["100.0000", "100.1000", "100.2000", "100.3000", "gone"]);
    assert_eq!(dataset.frames[2].time, Some(100.2));
    assert_eq!(
        (dataset.frames[2].position, dataset.frames[2].axes),
        (DVec3::new(2.0, 0.0, 0.0), DMat3::IDENTITY)
    );
    let found = listed(&dataset);
    assert_eq!(found[0], ("late", "no pose: the nearest in time is 0.046 s away"));
    assert!(
        found[1].0 == "gone" && found[1].1.starts_with("picture missing") && found.len() == 2,
        "{found:?}"
    );
    let lens = dataset.frames[0].lens;
    assert_eq!((lens.intrinsics.cx, lens.intrinsics.width), (320.6, 640));
    // The pictures of the sample are a tenth of the benchmark's.
    let view = dataset.load_views(&[1], None).unwrap().remove(0);
    assert!((view.camera().intrinsics().fx - 53.54).abs() < 1e-12);
    assert_eq!((view.depth().unwrap().data()[0], view.depth().unwrap().data()[64]), (0.0, 2.0));
    // Depth times lie 11 ms, pose times 4 ms away.
    let dataset = open_tum_within(&path, 0.01).unwrap();
    assert!(dataset.frames[0].depth.is_none());
    check_error(
        open_tum_within(&path, 0.001),
        "rgb.txt: has no frames with a pose, expected at least one; 6 pictures, 4",
    );
}

#[test]
fn tum_cameras_of_the_first_two_kinds_undistort_and_others_are_stated() {
    let (folder, path) = sample(Format::Tum, "rgbd_dataset_freiburg3_desk");
    for (name, fx, cx) in [("rgbd_dataset_freiburg1_xyz", 517.3, 319.1), ("my_FR2_walk", 520.9, 325.6)] {
        let other = folder.root().join(name);
        std::fs::rename(&path, &other).unwrap();
        let lens = open_tum(&other).unwrap().frames[0].lens;
        assert_eq!((lens.intrinsics.fx, lens.intrinsics.cx), (fx, cx));
        for corner in [(0.5, 0.5), (639.5, 0.5), (0.5, 479.5), (639.5, 479.5)] {
            let pixel = DVec2::from(corner);
            let direction = lens.undistort(pixel).unwrap();
            assert!((lens.distort_one_to_one(direction).unwrap() - pixel).length() < 1e-9, "{name} {pixel}");
        }
        std::fs::rename(&other, &path).unwrap();
    }
    let own = folder.root().join("desk");
    std::fs::rename(&path, &own).unwrap();
    check_error(open_tum(&own), "desk/camera.txt: is not there: the camera is not known; write fx fy cx cy");
    samples::text(&own.join("camera.txt"), "# mine\n60, 61, 31.5, 23.5\n");
    let lens = open_tum(&own).unwrap().frames[0].lens;
    assert_eq!((lens.intrinsics.cx, lens.intrinsics.width, lens.model), (32.0, 64, LensModel::PINHOLE));
    samples::text(&own.join("camera.txt"), "60 61 31.5 23.5 0.1 0.01 0.001 0.002 0.003");
    let lens = open_tum(&own).unwrap().frames[0].lens;
    assert_eq!(lens.model.radial_tangential().unwrap().k3, 0.003);
    samples::text(&own.join("camera.txt"), "60 61 31.5");
    check_error(open_tum(&own), "camera.txt: line 1: 3 words, expected fx fy cx cy [k1 k2 p1 p2 [k3]]");
    samples::text(&own.join("camera.txt"), "");
    check_error(open_tum(&own), "camera.txt: 0 words");
}

#[test]
fn tum_names_every_broken_rule() {
    let (_folder, path) = sample(Format::Tum, "rgbd_dataset_freiburg3_desk");
    let with = |name: &str, text: &str| {
        let file = path.join(name);
        let before = std::fs::read(&file).unwrap();
        std::fs::write(&file, text).unwrap();
        let opened = open_tum(&path);
        std::fs::write(&file, before).unwrap();
        opened
    };
    check_error(with("rgb.txt", "1.0\n"), "rgb.txt: line 1: 1 words, expected TIME PATH");
    check_error(with("rgb.txt", "# c\none rgb/1.png\n"), "rgb.txt: line 2: TIME is \"one\"");
    check_error(with("depth.txt", "nan depth/1.png\n"), "depth.txt: line 1: TIME is NaN");
    check_error(
        with("groundtruth.txt", "1 2 3\n"),
        "groundtruth.txt: line 1: 3 words, expected TIME TX TY TZ QX",
    );
    check_error(
        with("groundtruth.txt", "1 0 0 0 0 0 0 0\n"),
        "line 1: pose has the quaternion [0.0, 0.0, 0.0, 0.0]",
    );
    check_error(with("groundtruth.txt", "1 0 0 inf 0 0 0 1\n"), "line 1: translation is inf");
    check_error(with("groundtruth.txt", ""), "rgb.txt: has no frames with a pose");
    std::fs::remove_file(path.join("depth.txt")).unwrap();
    assert!(open_tum(&path).unwrap().frames.iter().all(|frame| frame.depth.is_none()));
}

#[test]
fn tum_lists_without_pictures_are_named_and_not_the_camera() {
    let (_folder, path) = sample(Format::Tum, "rgbd_dataset_freiburg3_desk");
    std::fs::write(path.join("rgb.txt"), "# nothing\n").unwrap();
    check_error(
        open_tum(&path),
        "rgb.txt: has no frames with a pose, expected at least one; it lists no pictures",
    );
}

#[test]
fn scannet_reads_in_the_order_of_numbers_and_lists_lost_poses() {
    let (_folder, path) = sample(Format::ScanNet, "");
    samples::picture(&path.join("color/5.jpg"), 64, 48);
    samples::depth(&path.join("depth/77.png"), 32, 24, |_, _| 1);
    let dataset = open_scannet(&path).unwrap();
    assert_eq!(dataset.frames.iter().map(|f| &*f.name).collect::<Vec<_>>(), ["0", "2", "11"]);
    assert_eq!(dataset.frames[2].position, DVec3::new(11.5, 0.0, 0.0));
    let found = listed(&dataset);
    assert_eq!(
        found,
        [
            ("5", "no pose: there is no file of its number in pose/"),
            ("10", "no pose: it is not finite, tracking was lost"),
            ("depth/77.png", "no picture of its number in color/")
        ]
    );
    // A pixel of the picture is looked up in the depth picture where the depth camera sees its direction.
    let view = dataset.load_views(&[1], None).unwrap().remove(0);
    let camera = *view.camera().intrinsics();
    assert_eq!((camera.cx, camera.cy), (32.0, 24.0));
    for x in 0..64 {
        let place = 33.0 * (x as f64 + 0.5 - 32.0) / 60.0 + 16.0;
        let found = view.depth().unwrap().data()[24 * 64 + x];
        let expected = if (0.0..32.0).contains(&place) { (1000.0 + place.floor()) / 1000.0 } else { 0.0 };
        assert!((f64::from(found) - expected).abs() < 1e-6, "{x} {place} {found} {expected}");
    }
}

#[test]
fn scannet_names_every_broken_rule() {
    let (_folder, path) = sample(Format::ScanNet, "");
    let with = |name: &str, text: &str| {
        let file = path.join(name);
        let before = std::fs::read(&file).unwrap();
        std::fs::write(&file, text).unwrap();
        let opened = open_scannet(&path);
        std::fs::write(&file, before).unwrap();
        opened
    };
    check_error(with("pose/2.txt", "1 0 0 0\n"), "pose/2.txt: 4 words, expected 4 lines of 4 numbers");
    check_error(with("pose/2.txt", "1 0 0\n"), "pose/2.txt: line 1: 3 words, expected 4 lines of 4 numbers");
    check_error(with("pose/2.txt", "1 0 0 x\n"), "pose/2.txt: line 1: a number of the matrix is \"x\"");
    check_error(
        with("pose/2.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        "pose/2.txt: pose holds no rotation",
    );
    let name = "intrinsic/intrinsic_color.txt";
    check_error(with(name, "60 1 31 0\n0 60 23 0\n0 0 1 0\n0 0 0 1\n"), "intrinsic_color.txt: skew is 1");
    check_error(with(name, "60 0 640 0\n0 60 23 0\n0 0 1 0\n0 0 0 1\n"), "principal point is [640.0, 23.0]");
    check_error(with(name, "0 0 31 0\n0 60 23 0\n0 0 1 0\n0 0 0 1\n"), "focal length fx is 0");
    std::fs::remove_file(path.join(name)).unwrap();
    check_error(open_scannet(&path), "intrinsic_color.txt: is not there: the camera is not known; it holds");
    std::fs::remove_dir_all(path.join("color")).unwrap();
    check_error(open_scannet(&path), "color: has no frames with a pose");
}

#[test]
fn exr_depth_is_read_from_its_channel() {
    let (_folder, path) = sample(Format::Nerfstudio, "");
    let file = path.join("depth/1.exr");
    let load = || open(&path, None).unwrap().load_views(&[1], None);
    // A file of one channel may call it anything.
    for channel in ["Z", "Y", "R", "far away"] {
        samples::exr(&file, channel, (32, 24), |x, y| match (x, y) {
            (20, 10) => f32::NAN,
            (21, 10) => f32::INFINITY,
            (22, 10) => -1.0,
            _ => 1.0 + x as f32,
        });
        let view = load().unwrap().remove(0);
        let depth = view.depth().unwrap();
        // Undistorting cut a border off; no value is a blend of two, and floats are scene units.
        assert!(depth.data().iter().all(|z| *z == 0.0 || z.fract() == 0.0), "{channel}");
        assert_eq!(depth.data().iter().filter(|z| **z == 0.0).count(), 3, "{channel}");
    }
    samples::exr(&file, "Z", (32, 24), |x, _| x as f32);
    let whole = std::fs::read(&file).unwrap();
    for cut in (8..whole.len()).step_by(5) {
        std::fs::write(&file, &whole[..cut]).unwrap();
        assert!(chain(&load().unwrap_err()).contains("1.exr: "), "{cut}");
    }
    // A data window of 10000×10000 pixels in a file of some hundred bytes.
    let window = whole.windows(11).position(|w| w == b"dataWindow\0").unwrap() + 11 + 6 + 4;
    let mut lying = whole.clone();
    lying[window + 8..window + 16].copy_from_slice(&[0x0f, 0x27, 0, 0, 0x0f, 0x27, 0, 0]);
    std::fs::write(&file, &lying).unwrap();
    let message = chain(&load().unwrap_err());
    assert!(message.contains("bytes cannot hold the 10000x10000 pixels"), "{message}");
}

/// Changes a file of a data set; `kind` chooses how.
fn mutate(bytes: &mut Vec<u8>, kind: u8, a: usize, b: usize, byte: u8) {
    if bytes.is_empty() {
        return;
    }
    let (a, b) = (a % bytes.len(), b % bytes.len());
    match kind % 4 {
        0 => bytes[a] = byte,
        1 => bytes.truncate(a),
        2 => bytes.insert(a, byte),
        _ => {
            let piece = bytes[a.min(b)..a.max(b)].to_vec();
            bytes.splice(b..b, piece);
        }
    }
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() { files_below(&path, found) } else { found.push(path) }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]
    #[test]
    fn no_mutated_file_panics(
        which in 0..4_usize, file in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<u8>(), any::<usize>(), any::<usize>(), any::<u8>()), 1..4),
    ) {
        let format = [Format::Nerfstudio, Format::Replica, Format::Tum, Format::ScanNet][which];
        let folder = Folder::new();
        samples::write(format, "", folder.root());
        let mut files = Vec::new();
        files_below(folder.root(), &mut files);
        let path = &files[file.index(files.len())];
        let mut bytes = std::fs::read(path).unwrap();
        for (kind, a, b, byte) in changes {
            mutate(&mut bytes, kind, a, b, byte);
        }
        std::fs::write(path, bytes).unwrap();
        for scene in open_all(folder.root(), Some(format)).map(|all| all.scenes).unwrap_or_default() {
            prop_assert!(scene.cameras().is_ok());
            let _ = scene.points();
            for position in 0..scene.frames.len().min(2) {
                let _ = scene.load_views(&[position], None);
            }
        }
    }
}
