//! COLMAP's models: what COLMAP itself wrote, where pictures are found, and every rule that can be broken.

use crate::folder::{Folder, chain};
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Image, View};
use proptest::prelude::*;
use serde_json::Value;
use std::path::{Path, PathBuf};
use view_data::{DatasetWriter, Error, Format, Layout, LensModel, PictureFormat, open, open_colmap};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/colmap").join(name)
}

fn json(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(fixture(name)).unwrap()).unwrap()
}

fn floats(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// A scene's folder with a model in `place` of the given files.
fn scene(place: &str, files: &[(&str, &[u8])]) -> Folder {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.root().join(place)).unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.root().join(place).join(name), bytes).unwrap();
    }
    folder
}

/// A scene's folder with the fixture's model.
fn copy(kind: &str, place: &str) -> Folder {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.root().join(place)).unwrap();
    for name in ["cameras", "images", "points3D", "rigs", "frames"] {
        let file = format!("{name}.{kind}");
        std::fs::copy(fixture(kind).join(&file), folder.root().join(place).join(&file)).unwrap();
    }
    folder
}

#[test]
fn every_camera_model_sees_where_colmap_does() {
    for entry in json("lenses.json").as_array().unwrap() {
        let words = |value: &Value| floats(value).iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let (model, parameters) = (entry["model"].as_str().unwrap(), words(&entry["parameters"]));
        let cameras = format!("1 {model} 640 480 {parameters}\n");
        let folder =
            scene("", &[("cameras.txt", cameras.as_bytes()), ("images.txt", b"1 1 0 0 0 0 0 0 1 a.png\n\n")]);
        let lens = open_colmap(folder.root()).unwrap().frames[0].lens;
        let pairs = entry["directions"].as_array().unwrap().iter().zip(entry["pixels"].as_array().unwrap());
        for (direction, pixel) in pairs {
            let direction = DVec2::from_slice(&floats(direction));
            let pixel = DVec2::from_slice(&floats(pixel));
            let found = lens.distort(direction);
            assert!((found - pixel).length() < 1e-9, "{model} {direction}: {found}, COLMAP has {pixel}");
            let back = lens.undistort(pixel).unwrap();
            assert!((back - direction).length() < 1e-10, "{model} {pixel}: {back} {direction}");
            assert!((lens.distort(back) - pixel).length() < 1e-9, "{model} {pixel}");
            assert!(lens.distort_one_to_one(direction).is_some(), "{model} {direction}");
        }
    }
}

#[test]
fn a_model_that_colmap_wrote_reads_the_same_in_both_forms() {
    let expected = json("model.json");
    for kind in ["bin", "txt"] {
        let folder = copy(kind, "sparse/0");
        for name in ["b.png", "c.png", "d.png"] {
            folder.picture(&format!("images/{name}"), 64, 48);
        }
        // Another extension than the model's.
        folder.picture("images/left/a.jpg", 64, 48);
        for path in
            [folder.root().to_path_buf(), folder.root().join("sparse"), folder.root().join("sparse/0")]
        {
            let dataset = open(&path, None).unwrap();
            assert_eq!(dataset.format, Format::Colmap);
            let names: Vec<_> = dataset.frames.iter().map(|frame| &*frame.name).collect();
            assert_eq!(names, ["b", "c", "left_a.png", "right_a.png"], "{kind}");
            assert_eq!(dataset.present(), [0, 1, 2], "{kind} {}", path.display());
            let listed: Vec<_> =
                dataset.dropped.iter().map(|d| (&*d.key, d.reason.split(':').next())).collect();
            let unread = Some("not needed");
            assert_eq!(
                listed,
                [
                    ("right_a.png", Some("picture missing")),
                    ("d.png", Some("not registered")),
                    (&format!("rigs.{kind}"), unread),
                    (&format!("frames.{kind}"), unread)
                ]
            );
            check_model(&dataset, &expected);
        }
    }
}

fn check_model(dataset: &view_data::Dataset, expected: &Value) {
    let position =
        |name: &str| ["b.png", "c.png", "left/a.png", "right/a.png"].iter().position(|n| *n == name).unwrap();
    for image in expected["images"].as_array().unwrap() {
        let frame = &dataset.frames[position(image["name"].as_str().unwrap())];
        let camera = frame.camera().unwrap();
        for (r, row) in image["cam_from_world"].as_array().unwrap().iter().enumerate() {
            let row = floats(row);
            assert!((camera.rotation().row(r) - DVec3::from_slice(&row[..3])).length() < 1e-14);
            assert!((camera.translation()[r] - row[3]).abs() < 1e-13);
        }
        assert_eq!(frame.lens.model.is_pinhole(), image["model"] == "PINHOLE");
    }
    let points = dataset.points().unwrap().unwrap();
    assert!(dataset.has_points() && points.len() == 3);
    for point in expected["points"].as_array().unwrap() {
        let position_3d = DVec3::from_slice(&floats(&point["position"]));
        let found = points.iter().find(|found| (found.position - position_3d).length() < 1e-14).unwrap();
        assert_eq!(found.colour.map(|c| c.map(f64::from).to_vec()), Some(floats(&point["colour"])));
        let mut sightings: Vec<_> = found.observations.iter().map(|seen| (seen.frame, seen.pixel)).collect();
        let mut wanted = Vec::new();
        for seen in point["sightings"].as_array().unwrap() {
            let pixel = DVec2::new(seen[1].as_f64().unwrap(), seen[2].as_f64().unwrap());
            wanted.push((position(seen[0].as_str().unwrap()), pixel));
        }
        sightings.sort_by_key(|(frame, _)| *frame);
        wanted.sort_by_key(|(frame, _)| *frame);
        assert_eq!(sightings.len(), wanted.len());
        for ((frame, pixel), (wanted_frame, wanted_pixel)) in sightings.iter().zip(&wanted) {
            assert!(frame == wanted_frame && (*pixel - *wanted_pixel).length() < 1e-9);
            let lens = &dataset.frames[*frame].lens;
            let seen = dataset.frames[*frame].camera().unwrap().to_camera(found.position);
            assert!((lens.distort(seen.truncate() / seen.z) - *pixel).length() < 1e-9);
        }
    }
}

#[test]
fn binary_is_preferred_and_smaller_pictures_scale_the_intrinsics() {
    let folder = copy("bin", "sparse/0");
    std::fs::write(folder.path("sparse/0/cameras.txt"), "nonsense").unwrap();
    std::fs::write(folder.path("sparse/0/images.txt"), "nonsense").unwrap();
    for name in ["b", "c", "left/a", "right/a"] {
        folder.picture(&format!("images_4/{name}.png"), 160, 120);
    }
    let dataset = open(folder.root(), None).unwrap();
    let view = dataset.load_views(&[2], None).unwrap().remove(0);
    let lens = view.camera().intrinsics();
    assert_eq!((lens.fx, lens.fy, lens.cx, lens.cy), (155.0, 153.75, 80.375, 59.75));
    assert_eq!((lens.width, lens.height), (160, 120));
}

#[test]
fn other_models_of_a_scene_are_listed() {
    let folder = copy("txt", "sparse/0");
    for name in ["cameras.txt", "images.txt"] {
        std::fs::copy(fixture("txt").join(name), folder.path(&format!("sparse/1/{name}"))).unwrap();
    }
    let dropped = open(folder.root(), None).unwrap().dropped;
    assert!(dropped.iter().any(|entry| entry.key.ends_with("1") && entry.reason.contains("another model")));
}

#[test]
fn what_is_written_is_read() {
    let folder = Folder::new();
    let image = Image::new(16, 12, vec![0.5; 16 * 12 * 3]).unwrap();
    for (layout, name) in [(Layout::Colmap, "binary"), (Layout::ColmapText, "text")] {
        let target = folder.root().join(name);
        let mut writer = DatasetWriter::create(&target, layout, PictureFormat::Png).unwrap();
        let mut cameras = Vec::new();
        for i in 0..3 {
            let intrinsics =
                gs_scene::Intrinsics { fx: 20.0, fy: 21.0, cx: 8.5, cy: 6.0, width: 16, height: 12 };
            let rotation = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, f64::from(i), -2.0);
            let camera =
                gs_scene::Camera::new(intrinsics, rotation, DVec3::new(1.0, f64::from(i), 3.0)).unwrap();
            cameras.push(camera);
            let view = View::new(format!("view {i}"), image.clone(), camera, None).unwrap();
            writer.add(&view, &view_data::Lens { intrinsics, model: LensModel::PINHOLE }).unwrap();
        }
        writer.finish().unwrap();
        let views = open(&target, None).unwrap().load_views(&[0, 1, 2], None).unwrap();
        for (i, (view, camera)) in views.iter().zip(&cameras).enumerate() {
            assert_eq!(view.name(), format!("view {i}"));
            let turn = (view.camera().rotation() - camera.rotation()).to_cols_array();
            assert!(turn.iter().all(|entry| entry.abs() < 1e-14), "{turn:?}");
            assert!((view.camera().position() - camera.position()).length() < 1e-13);
        }
    }
}

/// The message of opening a text model of these files.
fn message(cameras: &str, images: &str) -> String {
    let files = [("cameras.txt", cameras.as_bytes()), ("images.txt", images.as_bytes())];
    let folder = scene("sparse", &files);
    chain(&open_colmap(folder.root()).unwrap_err())
}

const CAMERA: &str = "1 PINHOLE 64 48 60 60 32 24";
const IMAGE: &str = "1 1 0 0 0 0 0 0 1 a.png";

#[test]
fn every_broken_rule_of_the_text_form_is_named() {
    let camera = |line: &str, expected: &str| {
        let found = message(&format!("# a comment\n{line}\n"), IMAGE);
        assert!(found.contains("sparse/cameras.txt: line 2: "), "{found}");
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    };
    camera("1 PINHOLE 64", "3 words, expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS");
    camera("one PINHOLE 64 48 1 1 1 1", "CAMERA_ID is \"one\", expected a whole number");
    camera("1 PIN 64 48 1 1 1 1", "camera model PIN is not known");
    camera("1 EQUIRECTANGULAR 64 48 64 48", "EQUIRECTANGULAR cannot be undistorted to a pinhole");
    camera("1 PINHOLE 64 48 1 1 1", "camera model PINHOLE has 4 parameters, found 3");
    camera("1 PINHOLE -64 48 1 1 1 1", "WIDTH is \"-64\"");
    camera("1 PINHOLE 0 48 1 1 1 1", "the camera is not valid: size is 0x48");
    camera("1 PINHOLE 99999999999 48 1 1 1 1", "the camera is not valid: size is");
    camera("1 PINHOLE 64 48 0 1 1 1", "the camera is not valid: focal length fx is 0");
    camera("1 PINHOLE 64 48 nan 1 1 1", "a parameter is NaN, expected a finite number");
    camera("1 EUCM 64 48 1 1 1 1 2 1", "coefficients of camera model EUCM are out of range: [2.0, 1.0]");
    let found = message(&format!("{CAMERA}\n{CAMERA}\n"), IMAGE);
    assert!(found.contains("cameras.txt: line 2: camera id 1 occurs twice"), "{found}");

    let image = |line: &str, expected: &str| {
        let found = message(CAMERA, &format!("{IMAGE}\n\n{line}\n"));
        assert!(found.contains("sparse/images.txt: line 3: "), "{found}");
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    };
    image("2 1 0 0", "4 words, expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
    image("2 1 0 0 0 0 0 0 1", "9 words, expected IMAGE_ID");
    image("2 0 0 0 0 0 0 0 1 b.png", "pose has the quaternion [0.0, 0.0, 0.0, 0.0]");
    image("2 nan 0 0 0 0 0 0 1 b.png", "quaternion is NaN, expected a finite number");
    image("2 1 0 0 0 inf 0 0 1 b.png", "translation is inf");
    image("2 1 0 0 0 x 0 0 1 b.png", "translation is \"x\", expected a number");
    image("2 1 0 0 0 0 0 0 9 b.png", "camera 9 of image \"b.png\" is not in the list of cameras");
    image("2 1 0 0 0 0 0 0 1 a.png", "image name a.png occurs twice");
    image("2 1 0 0 0 0 0 0 1 ../../etc/passwd", "image name \"../../etc/passwd\" is not a path below");
    image("2 1 0 0 0 0 0 0 1 /etc/passwd", "is not a path below the folder of pictures");
    let found = message(CAMERA, "# nothing\n");
    assert!(found.contains("images.txt: has no frames with a pose"), "{found}");
}

#[test]
fn names_may_hold_spaces_quaternions_any_length_and_second_lines_anything() {
    let images = "1 2 0 0 0 0 0 0 1 my holiday/a 1.png\r\n# 3 4 -1\r\n2 0 0 1e-200 0 0 0 0 1 b.png";
    let folder = scene("", &[("cameras.txt", CAMERA.as_bytes()), ("images.txt", images.as_bytes())]);
    folder.picture("images/my holiday/a 1.png", 64, 48);
    let dataset = open_colmap(folder.root()).unwrap();
    assert_eq!(dataset.frames.iter().map(|f| &*f.name).collect::<Vec<_>>(), ["b", "a 1"]);
    assert_eq!((dataset.present(), dataset.has_points()), (vec![1], false));
    assert_eq!(dataset.frames[1].axes, DMat3::IDENTITY);
    assert_eq!(dataset.frames[0].axes, DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0)));
}

#[test]
fn binary_files_that_lie_or_end_early_are_refused_before_anything_is_allocated() {
    let read = |name: &str| std::fs::read(fixture("bin").join(name)).unwrap();
    let (cameras, images, points) = (read("cameras.bin"), read("images.bin"), read("points3D.bin"));
    let open_points = |cameras: &[u8], images: &[u8], points: &[u8]| {
        let files = [("cameras.bin", cameras), ("images.bin", images), ("points3D.bin", points)];
        open_colmap(scene("", &files).root())?.points()
    };
    assert_eq!(open_points(&cameras, &images, &points).unwrap().unwrap().len(), 3);
    for (i, whole) in [&cameras, &images, &points].into_iter().enumerate() {
        for cut in 0..whole.len() {
            let mut files = [&cameras[..], &images[..], &points[..]];
            files[i] = &whole[..cut];
            let error = open_points(files[0], files[1], files[2]).unwrap_err();
            assert!(matches!(error, Error::Format { .. }), "{i} {cut}: {}", chain(&error));
        }
        let mut lying = whole.clone();
        lying[..8].copy_from_slice(&(1_u64 << 60).to_le_bytes());
        let more = [whole.as_slice(), b"more"].concat();
        for (changed, expected) in [(lying, "1152921504606846976 "), (more, "4 bytes follow the last")] {
            let mut files = [&cameras[..], &images[..], &points[..]];
            files[i] = &changed;
            let message = chain(&open_points(files[0], files[1], files[2]).unwrap_err());
            assert!(message.contains(expected) && message.contains(".bin: byte "), "{message}");
        }
    }
    let mut unknown = cameras.clone();
    unknown[12] = 99;
    let message = chain(&open_points(&unknown, &images, &points).unwrap_err());
    assert!(message.contains("cameras.bin: byte 16: camera model 99 is not known"), "{message}");
    unknown[12] = 17;
    let message = chain(&open_points(&unknown, &images, &points).unwrap_err());
    assert!(message.contains("EQUIRECTANGULAR cannot be undistorted"), "{message}");
}

#[test]
fn points_keep_to_their_rules() {
    let with = |points: &str| {
        let files = [
            ("cameras.txt", CAMERA.as_bytes()),
            ("images.txt", b"1 1 0 0 0 0 0 0 1 a.png\n1 2 7 3 4 8 5 6 -1"),
            ("points3D.txt", points.as_bytes()),
        ];
        let folder = scene("", &files);
        let dataset = open_colmap(folder.root()).unwrap();
        dataset.points().map(Option::unwrap).map_err(|error| chain(&error))
    };
    // Point 8 has been filtered out of the file.
    let points = with("7 1 2 3 255 0 1 nan 1 0\n").unwrap();
    assert_eq!((points.len(), points[0].error, points[0].observations.len()), (1, None, 1));
    assert_eq!(points[0].observations[0].pixel, DVec2::new(1.0, 2.0));
    for (text, expected) in [
        ("7 1 2 3 255 0\n", "points3D.txt: line 1: 6 words, expected POINT3D_ID X Y Z R G B ERROR"),
        ("7 1 2 inf 255 0 1 0\n", "line 1: position is inf"),
        ("7 1 2 3 256 0 1 0\n", "colour is \"256\", expected a whole number from 0 to 255"),
        ("7 1 2 3 25 0 1 0\n7 1 2 3 25 0 1 0\n", "points3D.txt: a point id"),
    ] {
        let message = with(text).unwrap_err();
        assert!(message.contains(expected), "{message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]
    #[test]
    fn no_changed_byte_panics(
        kind in prop::sample::select(vec!["bin", "txt"]), name in prop::sample::select(vec!["cameras", "images", "points3D"]),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let folder = copy(kind, "");
        let path = folder.path(&format!("{name}.{kind}"));
        let mut bytes = std::fs::read(&path).unwrap();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        std::fs::write(&path, bytes).unwrap();
        if let Ok(dataset) = open_colmap(folder.root()) {
            prop_assert!(dataset.cameras().is_ok());
            let _ = dataset.points();
        }
    }
}

#[test]
fn a_text_model_without_lines_of_features_keeps_every_image() {
    let cameras = b"1 PINHOLE 64 48 60 60 32 24\n".as_slice();
    let line = |id: usize, name: &str| format!("{id} 1 0 0 0 {id} 0 0 1 {name}\n");
    // By hand without second lines; with spaces in a name; and the two mixed with what COLMAP writes.
    let bare = [line(1, "a.png"), line(2, "b c.png"), line(3, "d.png")].concat();
    let mixed = [line(1, "a.png"), "1.5 2 -1\n".to_owned(), line(2, "b c.png"), line(3, "d.png")].concat();
    let written = [line(1, "a.png"), "\n".into(), line(2, "b c.png"), "\n".into(), line(3, "d.png")].concat();
    for images in [bare, mixed, written] {
        let folder = scene("", &[("cameras.txt", cameras), ("images.txt", images.as_bytes())]);
        let dataset = open_colmap(folder.root()).unwrap();
        let mut found: Vec<f64> = dataset.frames.iter().map(|frame| frame.position.x).collect();
        found.sort_by(f64::total_cmp);
        assert_eq!(found, [-3.0, -2.0, -1.0], "{images}");
    }
}
