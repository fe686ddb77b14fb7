//! RealEstate10K's camera files and frames.

use crate::folder::{Folder, chain};
use proptest::prelude::*;
use view_data::{Error, Format, ImageSource, Re10kRule, list_re10k, open, open_re10k};

fn line(timestamp: u64, x: f64) -> String {
    format!("{timestamp} 0.5 0.75 0.5 0.4 0.0 0.0 1.0 0.0 0.0 {} 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0", -x)
}

fn text(lines: &[String]) -> String {
    format!("https://example.invalid/watch?v=x\n{}\n", lines.join("\n"))
}

/// A clip of three frames, the second one a JPEG.
fn clip(folder: &Folder, home: &str) {
    let lines = [line(1_000_000, 0.0), line(1_033_366, 1.0), line(1_066_733, 2.0)];
    std::fs::write(folder.path(&format!("{home}.txt")), text(&lines)).unwrap();
    folder.picture(&format!("{home}/1000000.png"), 40, 20);
    folder.picture(&format!("{home}/1033366.jpg"), 40, 20);
    folder.picture(&format!("{home}/1066733.png"), 40, 20);
}

#[test]
fn cameras_and_frames_are_joined_by_timestamp() {
    let folder = Folder::new();
    clip(&folder, "test/00a1");
    clip(&folder, "train/00b2");
    let scenes = open_re10k(folder.root()).unwrap();
    assert!(scenes.dropped.is_empty(), "{:?}", scenes.dropped);
    assert_eq!(scenes.scenes.iter().map(|scene| scene.name.as_str()).collect::<Vec<_>>(), ["00a1", "00b2"]);
    let scene = &scenes.scenes[0];
    assert_eq!(scene.format, Format::Re10k);
    assert_eq!(scene.url.as_deref(), Some("https://example.invalid/watch?v=x"));
    let frame = &scene.frames[1];
    assert_eq!((frame.name.as_str(), frame.time), ("1033366", Some(1.033_366)));
    let intrinsics = frame.lens.intrinsics;
    assert_eq!([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], [20.0, 15.0, 20.0, 8.0]);
    assert!((frame.position - glam::DVec3::X).length() < 1e-12);
    assert_eq!(scene.load_views(&[0, 1, 2], None).unwrap().len(), 3);
    assert_eq!(open(&folder.root().join("test"), None).unwrap().name, "00a1");
}

#[test]
fn what_is_missing_or_left_over_is_listed() {
    let folder = Folder::new();
    clip(&folder, "00a1");
    std::fs::remove_file(folder.path("00a1/1033366.jpg")).unwrap();
    folder.picture("00a1/77.png", 40, 20);
    folder.picture("00a1/1000000.jpg", 40, 20);
    std::fs::write(folder.path("00b2.txt"), text(&[line(1, 0.0)])).unwrap();
    let list = list_re10k(folder.root()).unwrap();
    assert_eq!(list.entries.len(), 1);
    assert!(
        list.dropped[0].key == "00b2" && list.dropped[0].reason.starts_with("no folder "),
        "{:?}",
        list.dropped
    );
    let scene = list.open("00a1").unwrap();
    assert_eq!(scene.present(), [0, 2]);
    assert!(matches!(scene.frames[1].image, ImageSource::Missing(_)));
    let reasons: Vec<_> = scene.dropped.iter().map(|dropped| dropped.reason.as_str()).collect();
    assert_eq!(reasons[..2], ["a picture of this timestamp comes before", "no camera for this picture"]);
    assert!(scene.dropped[2].key == "1033366" && reasons[2].starts_with("picture missing: "), "{reasons:?}");
    assert!(scene.load_views(&[1], None).is_err());
}

#[test]
fn every_rule_is_named_with_its_line() {
    let folder = Folder::new();
    let good = line(1, 0.0);
    let replaced = |from: &str, to: &str| text(&[good.clone(), line(2, 0.0).replacen(from, to, 1)]);
    let cases = [
        (text(&[]), "00a1.txt: has no cameras"),
        (String::new(), "00a1.txt: has no cameras"),
        (text(&[good.clone(), "3 4".to_owned()]), "line 3: has 2 columns, expected 19"),
        (replaced("0.75", "x"), "line 3: column 2 is \"x\", expected a number"),
        (replaced("2 ", "2.5 "), "line 3: timestamp is \"2.5\""),
        (text(&[good.clone(), String::new(), good.clone()]), "line 4: timestamp 1 occurs twice"),
        (replaced("0.75", "nan"), "line 3: column 1 of the camera is not finite"),
        (replaced("1.0 0.0 0.0", "1.0 0.4 0.0"), "line 3: pose holds no rotation"),
        (replaced("0.75", "-1"), "line 3: the camera is not valid"),
        (text(&[line(9, 0.0)]), "none of the 1 pictures is there"),
    ];
    folder.picture("00a1/1.png", 40, 20);
    folder.picture("00a1/2.png", 40, 20);
    for (content, message) in cases {
        std::fs::write(folder.path("00a1.txt"), content).unwrap();
        let error = list_re10k(folder.root()).unwrap().open("00a1").unwrap_err();
        assert!(chain(&error).contains(message), "{} instead of {message}", chain(&error));
        assert!(matches!(error, Error::Re10k { .. }));
    }
    std::fs::write(folder.path("00a1.txt"), b"\xff\n1").unwrap();
    let error = list_re10k(folder.root()).unwrap().open("00a1").unwrap_err();
    assert!(matches!(error, Error::Re10k { rule: Re10kRule::NotText, .. }));
}

proptest! {
    /// Damaged text is an error or a data set, and the picture's folder is no way out of it.
    #[test]
    fn damaged_camera_files_never_panic(
        flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..5),
        cut in proptest::option::of(any::<prop::sample::Index>()),
    ) {
        let folder = Folder::new();
        clip(&folder, "00a1");
        let path = folder.path("00a1.txt");
        let mut bytes = std::fs::read(&path).unwrap();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        std::fs::write(&path, bytes).unwrap();
        if let Ok(scene) = list_re10k(folder.root()).unwrap().open("00a1") {
            prop_assert!(scene.cameras().is_ok());
            prop_assert!(scene.frames.iter().all(|frame| frame.image.path().starts_with(folder.root())));
        }
    }
}
