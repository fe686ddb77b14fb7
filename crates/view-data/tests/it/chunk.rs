//! Chunks: those of PyTorch in fixtures/chunks, and broken ones made here.

use crate::folder::{Folder, chain};
use crate::pickle::error_of;
use crate::torch_file::{Elements, Saved, Scene, png, row, write_chunk};
use serde_json::Value;
use std::path::{Path, PathBuf};
use view_data::{Error, ImageSource, Scenes, list_chunks, open_chunks};

/// Breaks what a test is about to write.
pub(crate) type Break<T> = Box<dyn FnOnce(&mut T)>;

pub(crate) fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/chunks")
}

/// The dropped scenes as `key: reason`.
pub(crate) fn ledger(scenes: &Scenes) -> Vec<String> {
    scenes.dropped.iter().map(|dropped| format!("{}: {}", dropped.key, dropped.reason)).collect()
}

#[test]
fn what_pytorch_wrote_is_what_was_put_in() {
    assert_are_as_expected(&open_chunks(&fixtures()).unwrap(), &["aa01", "bb02", "cc03"]);
}

#[test]
fn the_format_before_version_1_6_is_read_too() {
    assert_are_as_expected(&open_chunks(&fixtures().join("legacy.pt")).unwrap(), &["bb02"]);
}

fn assert_are_as_expected(scenes: &Scenes, names: &[&str]) {
    let expected: Value =
        serde_json::from_slice(&std::fs::read(fixtures().join("expected.json")).unwrap()).unwrap();
    let expected = expected["scenes"].as_object().unwrap();
    assert_eq!(scenes.scenes.iter().map(|scene| &scene.name).collect::<Vec<_>>(), names);
    for scene in &scenes.scenes {
        let expected = &expected[&scene.name];
        assert_eq!(scene.url.as_deref(), expected["url"].as_str());
        let list = |key| expected[key].as_array().unwrap();
        assert_eq!(scene.frames.len(), list("images").len());
        for (i, frame) in scene.frames.iter().enumerate() {
            assert_eq!(frame.name, list("timestamps")[i].to_string());
            let ImageSource::Encoded { path, offset, length } = &frame.image else { panic!() };
            let file = std::fs::read(path).unwrap();
            let bytes = &file[*offset as usize..][..*length as usize];
            let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(Some(hex.as_str()), list("images")[i].as_str());

            let row: Vec<f64> =
                list("cameras")[i].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            let intrinsics = frame.lens.intrinsics;
            let (w, h) = (intrinsics.width as f64, intrinsics.height as f64);
            assert_eq!((w, h), if scene.name == "bb02" { (16.0, 24.0) } else { (20.0, 12.0) });
            let found = [intrinsics.fx / w, intrinsics.fy / h, intrinsics.cx / w, intrinsics.cy / h];
            assert!(found.iter().zip(&row).all(|(a, b)| (a - b).abs() < 1e-12));
            // A point of the world through the row's matrix, in f64; f32 rotations are mended by 1e-7 at most.
            let camera = frame.camera().unwrap();
            let seen = camera.to_camera(glam::DVec3::new(0.3, -1.2, 2.5));
            let expected = [0, 1, 2].map(|r| {
                let m = &row[6 + 4 * r..];
                0.3 * m[0] - 1.2 * m[1] + 2.5 * m[2] + m[3]
            });
            assert!(
                seen.to_array().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5),
                "{seen} {expected:?}"
            );
        }
        let views = scene.load_views(&[0, 1], None).unwrap();
        // Red runs from 0 to 1 along the row.
        let (width, image) = (views[0].image().width(), views[0].image());
        assert!(image.pixel(0, 0)[0] < 0.1 && image.pixel(width - 1, 0)[0] > 0.9);
    }
}

#[test]
fn broken_scenes_are_dropped_with_the_reason_and_the_rest_is_read() {
    let scenes = open_chunks(&fixtures()).unwrap();
    let ledger = ledger(&scenes);
    let expected = [
        ("dd04", "frame 1 (5000000001): column 9 of the camera is not finite"),
        ("ee05", "frame 0 (5000000000): translation of the camera is -50000, expected entries within ±1000"),
        ("ff06", "cameras are 3, but there are 2 images"),
    ];
    assert_eq!(ledger.len(), 3, "{ledger:?}");
    for (line, (key, reason)) in ledger.iter().zip(expected) {
        assert!(line.starts_with(key) && line.ends_with(reason), "{line}");
    }
}

#[test]
fn scenes_are_listed_by_the_index_or_by_the_chunks_and_opened_alone() {
    let by_index = list_chunks(&fixtures()).unwrap();
    let names: Vec<_> = by_index.entries.iter().map(|entry| entry.name.as_str()).collect();
    assert_eq!(names, ["aa01", "bb02", "cc03", "dd04", "ee05", "ff06"]);
    assert_eq!(by_index.open("bb02").unwrap().frames.len(), 3);
    assert!(chain(&by_index.open("ff06").unwrap_err()).contains("cameras are 3"));
    assert!(matches!(by_index.open("zz"), Err(Error::UnknownScene { .. })));

    let folder = Folder::new();
    for name in ["000000.torch", "000001.torch"] {
        std::fs::copy(fixtures().join(name), folder.path(&format!("test/{name}"))).unwrap();
    }
    let by_chunks = list_chunks(folder.root()).unwrap();
    assert_eq!(by_chunks.entries.iter().map(|entry| entry.name.as_str()).collect::<Vec<_>>(), names);
    let one = list_chunks(&fixtures().join("000000.torch")).unwrap();
    assert_eq!(one.entries.iter().map(|entry| entry.name.as_str()).collect::<Vec<_>>(), ["aa01", "bb02"]);
}

#[test]
fn an_index_that_disagrees_with_the_chunks_is_told() {
    let folder = Folder::new();
    write_chunk(&folder.path("a.torch"), &[Scene::new("one", 2)]);
    write_chunk(&folder.path("b.torch"), &[Scene::new("two", 2)]);
    let index = folder.path("index.json");
    std::fs::write(&index, r#"{"one": "a.torch", "three": "a.torch", "four": "gone.torch"}"#).unwrap();
    let scenes = open_chunks(folder.root()).unwrap();
    assert_eq!(scenes.scenes.len(), 1);
    let ledger = ledger(&scenes);
    assert!(ledger[0].starts_with("four: chunk missing: "), "{ledger:?}");
    assert!(ledger[1].contains("b.torch: ") && ledger[1].ends_with("names no scene of it"), "{ledger:?}");
    assert!(ledger[2].ends_with("no such scene in this chunk"), "{ledger:?}");

    for (text, message) in [
        (r#"{"one": "../a.torch"}"#, r#"one: index names "../a.torch", expected the name of a chunk file"#),
        (r#"{"one": 3}"#, r#"one: index names "3""#),
        (r#"{"o/e": "a.torch"}"#, r#"name of the scene is "o/e""#),
        (r#"{"one": "a.torch", "one": "b.torch"}"#, "key occurs twice"),
        ("[1]", "not valid JSON"),
    ] {
        std::fs::write(&index, text).unwrap();
        let found = chain(&list_chunks(folder.root()).unwrap_err());
        assert!(found.contains(message), "{found}");
    }
}

#[test]
fn repeated_timestamps_give_way_to_positions() {
    let folder = Folder::new();
    let mut scene = Scene::new("s", 3);
    scene.timestamps = vec![5, 6, 5];
    write_chunk(&folder.path("a.torch"), &[scene]);
    let scenes = open_chunks(folder.root()).unwrap();
    let names: Vec<_> = scenes.scenes[0].frames.iter().map(|frame| frame.name.as_str()).collect();
    assert_eq!(names, ["0", "1", "2"]);
}

/// Opens a chunk of one scene that `breaks` has broken; the reason why it is dropped.
fn dropped(breaks: impl FnOnce(&mut Scene)) -> String {
    let folder = Folder::new();
    let mut scene = Scene::new("s", 2);
    breaks(&mut scene);
    let path = folder.path("a.torch");
    write_chunk(&path, &[scene, Scene::new("sound", 2)]);
    let scenes = open_chunks(&path).unwrap();
    assert_eq!(scenes.scenes.len(), 1, "the sound scene is read");
    assert_eq!(scenes.dropped.len(), 1);
    scenes.dropped[0].reason.clone()
}

#[test]
fn every_rule_of_a_scene_is_named() {
    let cases: [(&str, Break<Scene>); 10] = [
        ("name of the scene is \"a/b\"", Box::new(|scene| scene.key = "a/b".to_owned())),
        ("name of the scene is \"..\"", Box::new(|scene| scene.key = "..".to_owned())),
        ("cameras are 3, but there are 2 images", Box::new(|scene| scene.rows.push(row(3.0)))),
        ("timestamps are 3, but there are 2 images", Box::new(|scene| scene.timestamps.push(1))),
        ("has no images", Box::new(|scene| scene.images.clear())),
        ("frame 1 (107): image has 5 bytes", Box::new(|scene| scene.images[1].truncate(5))),
        ("picture cannot be decoded", Box::new(|scene| scene.images[1].fill(7))),
        ("column 12 of the camera is not finite", Box::new(|scene| scene.rows[0][12] = f32::INFINITY)),
        ("frame 1 (107): pose holds no rotation", Box::new(|scene| scene.rows[1][6] = 3.0)),
        ("column 4 of the camera is 0.25, expected 0", Box::new(|scene| scene.rows[0][4] = 0.25)),
    ];
    for (message, breaks) in cases {
        let found = dropped(breaks);
        assert!(found.contains(message), "{found} instead of {message}");
    }
}

#[test]
fn wrong_types_shapes_and_repetitions_are_named() {
    assert!(error_of(|saved| _ = saved.int(3)).ends_with("holds int, expected a list of scenes"));
    let many = error_of(|saved| _ = saved.op(b"](").op(&[b'N'; 2000]).op(b"e"));
    assert!(many.contains("lists 2000 scenes, more than a file of"), "{many}");

    let folder = Folder::new();
    let path = folder.path("a.torch");
    let open = |build: &dyn Fn(&mut Saved)| {
        let mut saved = Saved::new();
        saved.op(b"](");
        build(&mut saved);
        saved.op(b"e").write(&path);
        ledger(&open_chunks(&path).unwrap()).join("; ")
    };
    let found = open(&|saved| _ = saved.int(4).op(b"}}(").text("key").int(4).op(b"u"));
    for message in
        ["scene 0: ", "the scene is int, expected dict", "key \"key\" is missing", "key is int, expected str"]
    {
        assert!(found.contains(message), "{found}");
    }
    // The same dict three times: it is one scene.
    let found = open(&|saved| {
        Scene::new("s", 1).save(saved);
        saved.op(b"q\x01h\x01h\x01");
    });
    assert_eq!(found.matches("a scene of this name comes before").count(), 2, "{found}");

    let scene = |saved: &mut Saved, cameras: &[i64], images: &dyn Fn(&mut Saved)| {
        saved.op(b"}(").text("key").text("s").text("cameras");
        let count = cameras.iter().product::<i64>() as usize;
        saved.tensor(&Elements::F64(&vec![0.5; count]), cameras).text("images").op(b"](");
        images(saved);
        saved.op(b"eu");
    };
    let bytes = png(20, 10);
    let length = bytes.len() as i64;
    let sound = |saved: &mut Saved| _ = saved.tensor(&Elements::U8(&bytes), &[length]);
    let found = open(&|saved| scene(saved, &[1, 16], &sound));
    assert!(found.contains("cameras have shape [1, 16], expected [views, 18]"), "{found}");
    let found = open(&|saved| scene(saved, &[18], &sound));
    assert!(found.contains("cameras have shape [18], expected [views, 18]"), "{found}");
    let found =
        open(&|saved| scene(saved, &[1, 18], &|saved| _ = saved.tensor(&Elements::F32(&[1.0]), &[1])));
    assert!(found.contains("an image is a tensor, expected a uint8 tensor"), "{found}");
    let found =
        open(&|saved| scene(saved, &[1, 18], &|saved| _ = saved.tensor(&Elements::U8(&bytes), &[1, length])));
    assert!(found.contains(&format!("image is a tensor of shape [1, {length}]")), "{found}");
    // Every second byte of a storage is no file.
    let strided = |saved: &mut Saved| {
        saved.rebuild().storage("ByteStorage", bytes.clone(), length).view(0, &[length / 2], &[2]);
    };
    assert!(open(&|saved| scene(saved, &[1, 18], &strided)).contains("expected contiguous uint8 [bytes]"));
    // One picture and one camera, each two hundred times, without taking more room in the file.
    let found = open(&|saved| {
        saved.op(b"}(").text("key").text("s").text("cameras").rebuild();
        let bytes = row(0.0).iter().flat_map(|value| value.to_le_bytes()).collect();
        saved.storage("FloatStorage", bytes, 18).view(0, &[200, 18], &[0, 1]).text("images").op(b"](");
        sound(saved);
        saved.op(b"q\x05").op(&b"h\x05".repeat(199)).op(b"eu");
    });
    assert!(found.contains("images of the chunk are longer than the file"), "{found}");
}
