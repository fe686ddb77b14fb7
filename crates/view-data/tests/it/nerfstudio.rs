//! Reading `transforms.json`: conventions, fallbacks, and every rule that can be broken.

use crate::folder::{Folder, chain, pose, three_frames};
use glam::{DMat3, DVec3};
use proptest::prelude::*;
use serde_json::{Value, json};
use view_data::{DepthFile, Error, LensModel, open_nerfstudio};

/// The valid file with one change.
fn changed(change: impl FnOnce(&mut Value)) -> Folder {
    let (folder, mut value) = (Folder::new(), three_frames());
    change(&mut value);
    folder.json(&value);
    folder
}

#[track_caller]
fn check_error(change: impl FnOnce(&mut Value), expected: &str) {
    let message = changed(change).open_error();
    assert!(message.contains("transforms.json"), "no file in {message:?}");
    assert!(message.contains(expected), "{message:?} does not contain {expected:?}");
}

#[test]
fn a_plain_file_reads_in_its_own_order_with_opencv_axes() {
    let folder = changed(|file| file["frames"][0]["file_path"] = json!("images/9.png"));
    for path in [folder.root().to_path_buf(), folder.root().join("transforms.json")] {
        let dataset = open_nerfstudio(&path).unwrap();
        assert_eq!(dataset.frames.iter().map(|frame| &frame.name).collect::<Vec<_>>(), ["9", "1", "2"]);
        assert_eq!(dataset.name, folder.root().file_name().unwrap().to_str().unwrap());
        let lens = dataset.frames[0].lens.intrinsics;
        assert_eq!(
            (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height),
            (40.0, 41.0, 15.5, 12.5, 32, 24)
        );
        for (i, camera) in dataset.cameras().unwrap().iter().enumerate() {
            assert_eq!((camera.rotation(), camera.forward()), (DMat3::IDENTITY, DVec3::Z));
            assert_eq!(camera.position(), DVec3::new(i as f64, 0.0, 0.0));
        }
        assert_eq!(
            (dataset.depth_percentiles, dataset.applied_transform, dataset.applied_scale),
            (None, None, None)
        );
    }
}

#[test]
fn opengl_columns_one_and_two_are_flipped() {
    // A camera turned by a general rotation: x right stays, y up becomes down, z backward becomes forward.
    let opengl = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.9);
    let rows: Vec<Vec<f64>> =
        (0..3).map(|r| vec![opengl.x_axis[r], opengl.y_axis[r], opengl.z_axis[r], 1e4]).collect();
    let folder = changed(|file| file["frames"][0]["transform_matrix"] = json!(rows));
    let camera = folder.open().unwrap().frames[0].camera().unwrap();
    let world = camera.position() + 3.0 * opengl.x_axis + 2.0 * opengl.y_axis - 5.0 * opengl.z_axis;
    assert!((camera.to_camera(world) - DVec3::new(3.0, -2.0, 5.0)).length() < 1e-10);
    assert!((camera.position() - DVec3::splat(1e4)).length() < 1e-10);
}

#[test]
fn a_frame_overrides_the_file() {
    let folder = changed(|file| {
        file["frames"][1]["fl_x"] = json!(80);
        file["frames"][1]["k1"] = json!(0.01);
        file["frames"][2]["k1"] = json!(0.02);
        file["k1"] = json!(0.03);
    });
    let lenses: Vec<_> = folder.open().unwrap().frames.iter().map(|frame| frame.lens).collect();
    assert_eq!(lenses.iter().map(|lens| lens.intrinsics.fx).collect::<Vec<_>>(), [40.0, 80.0, 40.0]);
    assert_eq!(
        lenses.iter().map(|lens| lens.model.radial_tangential().unwrap().k1).collect::<Vec<_>>(),
        [0.03, 0.01, 0.02]
    );
}

#[test]
fn fisheye_and_rational_models_are_read() {
    let model = |name: &str, flag: bool| {
        let folder = changed(|f| {
            for (i, key) in ["k1", "k2", "k3", "k4"].into_iter().enumerate() {
                f[key] = json!(0.01 * (i + 1) as f64);
            }
            if flag {
                f["is_fisheye"] = json!(true);
            } else {
                f["camera_model"] = json!(name);
            }
        });
        folder.open().unwrap().frames[0].lens.model
    };
    let fisheye = LensModel::Fisheye { k: [0.01, 0.02, 0.03, 0.04] };
    for name in ["OPENCV_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_RADIAL_FISHEYE"] {
        assert_eq!(model(name, false), fisheye);
    }
    assert_eq!(model("", true), fisheye);
    let rational = LensModel::Rational { k: [0.01, 0.02, 0.03, 0.04, 0.0, 0.0], p: [0.0; 2] };
    assert_eq!(model("FULL_OPENCV", false), rational);
}

#[test]
fn extras_are_recorded() {
    let folder = changed(|file| {
        file["scene_depth_percentiles"] = json!({"0.5": 1, "2": 2, "50": 3.5, "98": 4, "99.5": 4});
        file["applied_transform"] = json!([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 2]]);
        file["applied_scale"] = json!(0.25);
        file["depth_unit_scale_factor"] = json!(0.01);
        file["something_else"] = json!({"deep": [1, null]});
        file["frames"][0]["depth_file_path"] = json!("depth/0.png");
        file["frames"][0]["mask_path"] = Value::Null;
        file["frames"][1]["mask_path"] = json!("masks\\1.png");
    });
    let dataset = folder.open().unwrap();
    assert_eq!(dataset.depth_percentiles.unwrap().p50, 3.5);
    let point = dataset.applied_transform.unwrap().transform_point3(DVec3::new(1.0, 2.0, 3.0));
    assert_eq!((point, dataset.applied_scale), (DVec3::new(2.0, 1.0, -1.0), Some(0.25)));
    let depth = DepthFile::new(folder.root().join("depth/0.png"), 0.01);
    assert_eq!((dataset.frames[0].depth.as_ref(), dataset.frames[1].depth.as_ref()), (Some(&depth), None));
    assert_eq!(dataset.frames[1].mask_path, Some(folder.root().join("masks/1.png")));
    assert_eq!(dataset.frames[0].mask_path, None);
}

#[test]
fn blender_files_take_focal_length_from_the_angle_and_size_from_the_picture() {
    let folder = Folder::new();
    folder.picture("train/r_0.5.png", 30, 20);
    folder.json(&json!({
        "camera_angle_x": 1.0,
        "frames": [{"file_path": "./train/r_0.5", "transform_matrix": pose(0.0)}],
    }));
    let frame = &folder.open().unwrap().frames[0];
    let lens = frame.lens.intrinsics;
    assert!((lens.fx - 15.0 / 0.5_f64.tan()).abs() < 1e-12 && lens.fy == lens.fx);
    assert_eq!((lens.cx, lens.cy, lens.width, lens.height), (15.0, 10.0, 30, 20));
    assert_eq!(frame.name, "r_0.5");
}

#[test]
fn a_picture_is_found_by_name_in_the_only_folder_that_has_it() {
    let folder = changed(|_| {});
    folder.picture("images_8/0.png", 4, 3);
    folder.picture("other/1.png", 4, 3);
    let dataset = folder.open().unwrap();
    assert_eq!(dataset.frames[0].image.path(), folder.root().join("images_8/0.png"));
    assert_eq!(dataset.frames[1].image.path(), folder.root().join("images/1.png"));
    folder.picture("images_4/0.png", 8, 6);
    let message = folder.open_error();
    assert!(message.contains("frame 0 (images/0.png): picture is not at file_path"), "{message}");
    assert!(message.contains("images_4") && message.contains("images_8"), "{message}");
    // What is where the file says needs no search.
    folder.picture("images/0.png", 32, 24);
    assert_eq!(folder.open().unwrap().frames[0].image.path(), folder.root().join("images/0.png"));
}

#[test]
fn equal_stems_are_told_apart_by_their_folder() {
    let folder = changed(|file| {
        file["frames"][0]["file_path"] = json!("left/1.png");
        file["frames"][1]["file_path"] = json!("right/1.png");
    });
    let dataset = folder.open().unwrap();
    assert_eq!(
        dataset.frames.iter().map(|frame| &*frame.name).collect::<Vec<_>>(),
        ["left_1.png", "right_1.png", "2"]
    );
}

#[test]
fn every_broken_rule_is_named() {
    check_error(|f| f["frames"] = json!([]), "frames is empty");
    check_error(|f| drop(f.as_object_mut().unwrap().remove("frames")), "key frames is missing");
    check_error(|f| f["frames"] = json!({"0": 1}), "frames is an object, expected a list");
    check_error(|f| *f = json!([1, 2]), "the file's content is a list, expected an object");
    check_error(|f| f["frames"][1] = json!("x"), "frame 1 (no file_path): the frame is a string");
    check_error(|f| f["frames"][1]["file_path"] = json!(""), "key file_path is missing");
    check_error(|f| f["frames"][1]["file_path"] = json!(7), "file_path is a number, expected a string");
    check_error(|f| f["frames"][2]["file_path"] = json!("./images/1.png"), "same picture as frame 1");
    check_error(|f| f["fl_x"] = Value::Null, "frame 0 (images/0.png): no intrinsics: neither fl_x");
    check_error(|f| f["fl_x"] = json!("40"), "fl_x is a string, expected a number");
    check_error(|f| f["fl_x"] = json!(-1), "the camera is not valid: focal length fx is -1");
    check_error(|f| f["fl_y"] = json!(0), "focal length fy is 0");
    check_error(|f| f["cx"] = json!([1]), "cx is a list");
    check_error(|f| f["depth_unit_scale_factor"] = json!(0), "depth_unit_scale_factor is 0");
    check_error(
        |f| f["camera_model"] = json!("EQUIRECTANGULAR"),
        "\"EQUIRECTANGULAR\" is not supported, expected one",
    );
    check_error(|f| f["k4"] = json!(0.001), "k4 is 0.001, but the camera model has no such coefficient");
    check_error(
        |f| {
            f["camera_model"] = json!("OPENCV_FISHEYE");
            f["p1"] = json!(0.001);
        },
        "p1 is 0.001, but the camera model has no such coefficient",
    );
    check_error(|f| f["ply_file_path"] = json!(1), "ply_file_path is a number, expected a string");
    check_error(
        |f| {
            f["camera_model"] = json!("PINHOLE");
            f["p1"] = json!(0.1);
        },
        "PINHOLE has no distortion",
    );
    check_error(
        |f| {
            f["fl_x"] = Value::Null;
            f["frames"][1]["fl_x"] = json!(3);
        },
        "frame 0 (images/0.png): fl_x is missing here but given on other frames",
    );
    check_error(
        |f| {
            f["fl_x"] = Value::Null;
            f["camera_angle_x"] = json!(57.3);
        },
        "camera_angle_x is 57.3, expected an angle between 0 and π",
    );
    let decreasing = json!({"0.5": 1, "2": 2, "50": 1.5, "98": 4, "99.5": 4});
    check_error(|f| f["scene_depth_percentiles"] = decreasing, "scene_depth_percentiles are [1.0, 2.0, 1.5");
    check_error(|f| f["scene_depth_percentiles"] = json!({"50": 1}), "key 0.5 is missing");
    check_error(
        |f| f["scene_depth_percentiles"] = json!([1]),
        "scene_depth_percentiles is a list, expected an object",
    );
}

#[test]
fn absurd_sizes_are_refused() {
    for (w, h) in
        [(json!(0), json!(1)), (json!(1e300), json!(24)), (json!(-5), json!(24)), (json!(31.5), json!(24))]
    {
        check_error(|f| (f["w"], f["h"]) = (w, h), "expected a whole number of pixels from 1 to 1048576");
    }
    check_error(
        |f| (f["w"], f["h"]) = (json!(1 << 20), json!(1 << 20)),
        "the camera is not valid: size is 1048576x",
    );
    assert!(changed(|f| f["w"] = json!(32.0)).open().is_ok());
}

#[test]
fn bad_poses_name_the_frame() {
    let pose_of_one = |change: fn(&mut Value), expected: &str| {
        check_error(
            |f| change(&mut f["frames"][1]["transform_matrix"]),
            &format!("frame 1 (images/1.png): {expected}"),
        );
    };
    pose_of_one(|m| *m = Value::Null, "key transform_matrix is missing");
    pose_of_one(|m| *m = json!([[1, 0], [0, 1]]), "transform_matrix has 2 rows, expected 4 rows");
    pose_of_one(|m| m[2] = json!([0, 0, 1]), "transform_matrix has a row of 3 numbers");
    pose_of_one(|m| m[2] = json!(3), "transform_matrix is a number, expected a list of lists");
    pose_of_one(|m| m[2][2] = Value::Null, "transform_matrix is null, expected a number");
    pose_of_one(|m| m[3] = json!([1, 2, 3, 1]), "last row of transform_matrix is [1.0, 2.0, 3.0, 1.0]");
    pose_of_one(|m| m[0][0] = json!(1.2), "transform_matrix holds no rotation");
    pose_of_one(|m| m[0][0] = json!(-1), "transform_matrix mirrors the scene");
    pose_of_one(|m| m[0][0] = json!(1e308), "transform_matrix holds no rotation");
    pose_of_one(|m| *m = json!(vec![[0, 0, 0, 0]; 3]), "transform_matrix holds no rotation");
    for word in ["NaN", "Infinity", "-Infinity"] {
        let folder = Folder::new();
        folder.text(&three_frames().to_string().replacen("2.0]", &format!("{word}]"), 1));
        assert!(
            folder.open_error().contains("frame 2 (images/2.png): transform_matrix is not finite"),
            "{word}"
        );
    }
    assert!(changed(|f| f["frames"][1]["transform_matrix"][0][3] = json!(-1e12)).open().is_ok());
}

#[test]
fn files_that_are_not_there_or_not_json() {
    let folder = Folder::new();
    assert!(matches!(folder.open(), Err(Error::Read { path, .. }) if path.ends_with("transforms.json")));
    folder.text("");
    assert!(folder.open_error().contains("transforms.json: not valid JSON: EOF"));
    folder.text(&format!("{}1{}", "[".repeat(100_000), "]".repeat(100_000)));
    assert!(folder.open_error().contains("recursion limit"));
    std::fs::write(folder.path("transforms.json"), b"\xff\xfe{").unwrap();
    assert!(matches!(folder.open(), Err(Error::Json { .. })));
    folder.text(&format!("\u{feff}{}", three_frames()));
    assert!(folder.open().is_ok());
    let text = three_frames().to_string();
    for cut in 0..text.len() {
        folder.text(&text[..cut]);
        assert!(matches!(folder.open(), Err(Error::Json { .. })), "{cut}");
    }
}

#[test]
fn a_missing_picture_is_found_out_when_its_size_is_needed() {
    let folder = changed(|f| f["w"] = Value::Null);
    let error = folder.open().unwrap_err();
    assert!(matches!(error, Error::MissingPicture { .. }), "{}", chain(&error));
}

/// Any value in place of any other.
fn junk() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        ".{0,6}".prop_map(Value::from),
        Just(json!([])),
        Just(json!({})),
        Just(json!([[[0]]])),
        Just(pose(1e300)),
    ]
}

proptest! {
    #[test]
    fn no_value_anywhere_panics(places in prop::collection::vec((any::<prop::sample::Index>(), junk()), 1..4)) {
        let mut file = three_frames();
        for (key, value) in [("k1", json!(0.1)), ("k4", json!(0)), ("camera_angle_x", json!(1)),
            ("applied_transform", pose(0.0)), ("scene_depth_percentiles", json!({"2": 1})), ("is_fisheye", json!(false))]
        {
            file[key] = value;
        }
        for (place, value) in places {
            let pointers = pointers(&file, String::new());
            *file.pointer_mut(&pointers[place.index(pointers.len())]).unwrap() = value;
        }
        let folder = Folder::new();
        folder.json(&file);
        if let Ok(dataset) = folder.open() {
            prop_assert!(dataset.cameras().is_ok());
        }
    }

    #[test]
    fn no_changed_byte_panics(at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let mut text = three_frames().to_string().into_bytes();
        let at = at.index(text.len());
        text[at] = byte;
        let folder = Folder::new();
        std::fs::write(folder.path("transforms.json"), text).unwrap();
        if let Ok(dataset) = folder.open() {
            prop_assert!(dataset.cameras().is_ok());
        }
    }
}

/// JSON pointers to every value below `value`.
fn pointers(value: &Value, prefix: String) -> Vec<String> {
    let below: Vec<_> = match value {
        Value::Array(list) => list.iter().enumerate().map(|(i, value)| (i.to_string(), value)).collect(),
        Value::Object(map) => map.iter().map(|(key, value)| (key.clone(), value)).collect(),
        _ => Vec::new(),
    };
    let nested = below.into_iter().flat_map(|(key, value)| pointers(value, format!("{prefix}/{key}")));
    let nested: Vec<_> = nested.collect();
    std::iter::once(prefix).chain(nested).collect()
}
