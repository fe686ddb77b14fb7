//! Recognising a layout, listing scenes, and the ledger.

use crate::folder::{Folder, three_frames};
use serde_json::json;
use view_data::{Error, Format, ImageSource, open, open_all};

#[test]
fn a_layout_is_recognised_by_what_lies_there() {
    let folder = Folder::new();
    let message = open(folder.root(), None).unwrap_err().to_string();
    for expected in
        ["no data set found; looked for", "nerfstudio (transforms.json or", "colmap (cameras and images"]
    {
        assert!(message.contains(expected), "{message}");
    }
    let message = open(folder.root(), Some(Format::Nerfstudio)).unwrap_err().to_string();
    assert!(message.contains("transforms.json") && !message.contains("colmap"), "{message}");
    folder.json(&three_frames());
    for format in [None, Some(Format::Nerfstudio)] {
        assert_eq!(open(folder.root(), format).unwrap().format, Format::Nerfstudio);
    }
    assert!(matches!(open(folder.root(), Some(Format::Tum)), Err(Error::NoLayout { .. })));
}

#[test]
fn formats_have_names_that_read_back() {
    for format in Format::ALL {
        assert_eq!(format.name().parse::<Format>().unwrap(), format);
    }
    let message = "nerf".parse::<Format>().unwrap_err().to_string();
    assert!(
        message.starts_with("format \"nerf\" is not known, expected one of nerfstudio, colmap"),
        "{message}"
    );
}

#[test]
fn scenes_below_a_folder_come_in_the_order_of_names_and_broken_ones_are_listed() {
    let folder = Folder::new();
    for (name, text) in
        [("b", three_frames().to_string()), ("a", three_frames().to_string()), ("c", "{".into())]
    {
        std::fs::write(folder.path(&format!("{name}/transforms.json")), text).unwrap();
    }
    std::fs::write(folder.path("readme.txt"), "").unwrap();
    std::fs::create_dir(folder.path("empty")).unwrap();
    let all = open_all(folder.root(), None).unwrap();
    assert_eq!(all.scenes.iter().map(|scene| &*scene.name).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!(all.dropped.len(), 1);
    assert!(all.dropped[0].reason.contains("c/transforms.json: not valid JSON: EOF"), "{:?}", all.dropped);
    assert_eq!(open_all(&folder.root().join("a"), None).unwrap().scenes.len(), 1);
    assert!(matches!(open_all(&folder.root().join("empty"), None), Err(Error::NoLayout { .. })));
    assert!(matches!(open_all(&folder.root().join("nowhere"), None), Err(Error::Read { .. })));
}

#[test]
fn a_missing_picture_keeps_its_position_and_is_listed() {
    let folder = Folder::new();
    let mut file = three_frames();
    file["frames"][1]["file_path"] = json!("images/gone");
    folder.json(&file);
    folder.picture("images/0.png", 32, 24);
    folder.picture("images/2.png", 32, 24);
    let dataset = folder.open().unwrap();
    let gone = ImageSource::Missing(folder.root().join("images/gone"));
    assert_eq!((dataset.frames.len(), &dataset.frames[1].image, dataset.present()), (3, &gone, vec![0, 2]));
    let listed: Vec<_> = dataset.dropped.iter().map(|entry| (&*entry.key, &*entry.reason)).collect();
    assert_eq!(listed.len(), 1);
    assert!(listed[0].0 == "gone" && listed[0].1.starts_with("picture missing: "), "{listed:?}");
    assert_eq!(dataset.load_views(&[0, 2], None).unwrap().len(), 2);
    assert!(
        matches!(dataset.load_views(&[1], None), Err(Error::MissingPicture { frame, .. }) if frame == "gone")
    );
}

#[test]
fn what_has_no_poses_is_called_by_its_name_with_what_to_do() {
    let folder = Folder::new();
    let refused = |path: &str, parts: &[&str]| {
        let error = open(&folder.path(path), None).unwrap_err();
        assert!(matches!(error, Error::NoPoses { .. }), "{error}");
        let message = error.to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "no {parts:?} in: {message}");
        assert!(open_all(&folder.path(path), None).unwrap_err().to_string() == message);
    };
    folder.picture("flat/0.png", 4, 4);
    folder.picture("flat/1.JPG", 4, 4);
    folder.picture("below/images/0.png", 4, 4);
    for file in ["clip.MP4", "set.zip", "videos/a.mov", "packed/a.tar.gz"] {
        std::fs::write(folder.path(file), b"").unwrap();
    }
    refused("flat", &["flat: 2 pictures", "poses", "estimated first", "transforms.json"]);
    refused("below", &["a picture"]);
    refused("clip.MP4", &["a video", "estimated first"]);
    refused("videos", &["a video"]);
    refused("set.zip", &["an archive: unpack it"]);
    refused("packed", &["an archive"]);
}

#[test]
fn a_folder_around_one_scene_is_that_scene_and_around_several_names_them() {
    let folder = Folder::new();
    std::fs::write(folder.path("around/fox/transforms.json"), three_frames().to_string()).unwrap();
    assert_eq!(open(&folder.root().join("around"), None).unwrap().name, "fox");
    std::fs::write(folder.path("around/owl/transforms.json"), three_frames().to_string()).unwrap();
    let message = open(&folder.root().join("around"), None).unwrap_err().to_string();
    assert!(
        message.contains("expected one scene, found 2: fox, owl") && message.contains("give"),
        "{message}"
    );
}

#[test]
fn a_set_in_parts_is_opened_by_its_folder_and_says_what_it_left() {
    let folder = Folder::new();
    for part in ["train", "test"] {
        std::fs::write(folder.path(&format!("transforms_{part}.json")), three_frames().to_string()).unwrap();
    }
    let dataset = open(folder.root(), None).unwrap();
    assert!(dataset.file.ends_with("transforms_train.json"));
    assert!(dataset.dropped.iter().any(|entry| entry.key == "transforms_test.json"), "{:?}", dataset.dropped);
    folder.json(&three_frames());
    assert!(open(folder.root(), None).unwrap().file.ends_with("transforms.json"));
}
