//! DL3DV's folders, full set and benchmark.

use crate::folder::{Folder, pose};
use serde_json::{Value, json};
use view_data::{Dataset, Format, Scenes, list_dl3dv, open, open_dl3dv, read_index};

/// What DL3DV ships: full-size intrinsics, pictures of another folder, frames out of order and not contiguous.
fn transforms() -> Value {
    let frame = |number: u32, x: f64| json!({"file_path": format!("images/frame_{number:05}.png"), "transform_matrix": pose(x)});
    json!({
        "camera_model": "OPENCV", "w": 256, "h": 144, "fl_x": 200.0, "fl_y": 201.0, "cx": 128.0, "cy": 72.0,
        "k1": 0.01, "k2": 0.0, "p1": 0.0, "p2": 0.0,
        "applied_transform": [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]],
        "frames": [frame(7, 0.5), frame(1, 0.0), frame(4, 1.0)],
    })
}

const HASHES: [char; 5] = ['a', 'b', 'c', 'd', 'e'];

fn hash(letter: char) -> String {
    letter.to_string().repeat(64)
}

fn scene(folder: &Folder, home: &str, images: &str, json: &Value, size: (u32, u32)) {
    std::fs::write(folder.path(&format!("{home}/transforms.json")), json.to_string()).unwrap();
    for number in [1, 4, 7] {
        folder.picture(&format!("{home}/{images}/frame_{number:05}.png"), size.0, size.1);
    }
}

fn ledger(scenes: &Scenes) -> Vec<String> {
    scenes.dropped.iter().map(|dropped| format!("{}: {}", dropped.key, dropped.reason)).collect()
}

fn checks(dataset: &Dataset, size: (usize, usize)) {
    assert_eq!(dataset.format, Format::Dl3dv);
    let names: Vec<_> = dataset.frames.iter().map(|frame| frame.name.as_str()).collect();
    assert_eq!(names, ["frame_00007", "frame_00001", "frame_00004"], "the order of the list");
    assert!(dataset.applied_transform.is_some());
    let view = &dataset.load_views(&[2], None).unwrap()[0];
    let camera = view.camera();
    // k1 > 0 bends outwards: undistorting covers the whole picture, so nothing or a line is cut.
    assert!(camera.width().abs_diff(size.0) <= 2 && camera.height().abs_diff(size.1) <= 2);
    let scale = size.0 as f64 / 256.0;
    assert!((camera.intrinsics().fx - 200.0 * scale).abs() < 1e-9);
    assert!((camera.position() - glam::DVec3::X).length() < 1e-12);
}

#[test]
fn the_full_set_and_the_benchmark_are_read_with_the_largest_pictures() {
    let folder = Folder::new();
    let (a, b) = (hash('a'), hash('b'));
    scene(&folder, &format!("1K/{a}"), "images_8", &transforms(), (32, 18));
    scene(&folder, &format!("1K/{a}"), "images_4", &transforms(), (64, 36));
    scene(&folder, &format!("2K/{b}"), "images_8", &transforms(), (32, 18));
    let scenes = open_dl3dv(folder.root()).unwrap();
    assert!(scenes.dropped.is_empty(), "{:?}", scenes.dropped);
    assert_eq!(scenes.scenes.iter().map(|scene| scene.name.as_str()).collect::<Vec<_>>(), [&a, &b]);
    checks(&scenes.scenes[0], (64, 36));
    checks(&scenes.scenes[1], (32, 18));

    let benchmark = Folder::new();
    scene(&benchmark, &format!("{a}/nerfstudio"), "images_8", &transforms(), (32, 18));
    scene(&benchmark, &format!("{a}/gaussian_splat"), "images_8", &transforms(), (32, 18));
    for path in [
        benchmark.root().to_path_buf(),
        benchmark.root().join(&a),
        benchmark.root().join(&a).join("nerfstudio"),
    ] {
        let scenes = open_dl3dv(&path).unwrap();
        assert_eq!(scenes.scenes.len(), 1);
        assert_eq!(scenes.scenes[0].name, a);
        checks(&scenes.scenes[0], (32, 18));
    }
    assert_eq!(open(benchmark.root(), None).unwrap().name, a);
    assert_eq!(open(benchmark.root(), None).unwrap().format, Format::Dl3dv);
}

#[test]
fn broken_scenes_are_dropped_with_the_reason() {
    let folder = Folder::new();
    let home = |letter| format!("1K/{}", hash(letter));
    scene(&folder, &home('a'), "images_8", &transforms(), (32, 18));
    folder.picture(&format!("{}/images_8/frame_00001.png", home('b')), 32, 18);
    let mut nan = transforms();
    nan["frames"][1]["transform_matrix"][0][0] = json!("NaN");
    let text = nan.to_string().replace("\"NaN\"", "NaN");
    std::fs::write(folder.path(&format!("{}/transforms.json", home('c'))), text).unwrap();
    folder.picture(&format!("{}/images_8/frame_00001.png", home('c')), 32, 18);
    let mut far = transforms();
    far["frames"][2]["transform_matrix"] = pose(-2e3);
    scene(&folder, &home('d'), "images_8", &far, (32, 18));
    std::fs::write(folder.path(&format!("{}/transforms.json", home('e'))), transforms().to_string()).unwrap();

    let scenes = open_dl3dv(folder.root()).unwrap();
    assert_eq!(scenes.scenes.len(), 1);
    let mut ledger = ledger(&scenes);
    ledger.sort();
    let expected = [
        "has pictures, but no transforms.json",
        "is not finite",
        "expected entries within ±1000",
        "has no folder of pictures",
    ];
    assert_eq!(ledger.len(), 4, "{ledger:?}");
    for ((line, letter), reason) in ledger.iter().zip(&HASHES[1..]).zip(expected) {
        assert!(line.starts_with(&hash(*letter)) && line.contains(reason), "{line}");
    }
    assert!(ledger[1].contains("frame 1 (images/frame_00001.png)"), "{}", ledger[1]);
}

#[test]
fn a_missing_picture_keeps_its_position() {
    let folder = Folder::new();
    scene(&folder, &hash('a'), "images_8", &transforms(), (32, 18));
    std::fs::remove_file(folder.path(&format!("{}/images_8/frame_00001.png", hash('a')))).unwrap();
    let scene = list_dl3dv(folder.root()).unwrap().open(&hash('a')).unwrap();
    assert_eq!((scene.frames.len(), scene.present()), (3, vec![0, 2]));
    assert!(scene.dropped[0].reason.contains("picture missing"));
    for number in [4, 7] {
        std::fs::remove_file(folder.path(&format!("{}/images_8/frame_{number:05}.png", hash('a')))).unwrap();
    }
    let reason = &open_dl3dv(folder.root()).unwrap().dropped[0].reason;
    assert!(reason.contains("none of the 3 pictures of transforms.json is in"), "{reason}");
}

#[test]
fn an_index_finds_its_scenes_by_hash_and_counts_positions_of_the_list() {
    let folder = Folder::new();
    scene(&folder, &format!("1K/{}", hash('a')), "images_8", &transforms(), (32, 18));
    let path = folder.path("index.json");
    let text = json!({hash('a'): {"context": [0, 2], "target": [1]}, hash('b'): null});
    std::fs::write(&path, text.to_string()).unwrap();
    let index = read_index(&path).unwrap();
    let scene = list_dl3dv(folder.root()).unwrap().open(&index.windows[0].scene).unwrap();
    let windows = index.windows_of(&scene).unwrap();
    let names: Vec<_> = windows[0].context.iter().map(|&at| scene.frames[at].name.as_str()).collect();
    assert_eq!(names, ["frame_00007", "frame_00004"]);
    assert_eq!(index.dropped.len(), 1);
}
