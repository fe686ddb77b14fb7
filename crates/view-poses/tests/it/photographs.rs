//! Which photographs are taken, and how.

use crate::scenes::{Set, jpeg_with_exif, picture, views};
use image::imageops::{blur, rotate90, rotate180};
use std::path::Path;
use view_poses::{Error, Photographs, list_photographs, prepare_photographs};

fn prepare(set: &Set, keep_all: bool) -> view_poses::Result<Photographs> {
    let input = set.photographs();
    let files = list_photographs(&input)?.files;
    prepare_photographs(&input, &files, &set.beside("images"), keep_all, &|_, _| ())
}

fn reason<'a>(found: &'a Photographs, name: &str) -> &'a str {
    let entry = found.dropped.iter().find(|entry| entry.key == name);
    &entry.unwrap_or_else(|| panic!("{name} is not among {:?}", found.dropped)).reason
}

#[test]
fn damaged_copied_and_blurred_photographs_are_left_out_with_the_reason() {
    let set = Set::of_views();
    let first = picture(&views()[0]);
    set.add("copy.png", &first);
    set.add("shaken.png", &blur(&picture(&views()[4]), 3.0));
    let whole = set.photographs().join("whole.jpg");
    picture(&views()[1]).save(&whole).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::remove_file(&whole).unwrap();
    std::fs::write(set.photographs().join("broken.jpg"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(set.photographs().join("empty.jpg"), b"").unwrap();
    std::fs::write(set.photographs().join("text.jpg"), b"no picture").unwrap();
    std::fs::write(set.photographs().join("notes.txt"), b"not a picture's name").unwrap();

    let found = prepare(&set, false).unwrap();
    assert_eq!((found.photographs.len(), found.found, found.dropped.len()), (8 - 1 + 1, 13, 5));
    assert!(reason(&found, "view00.png").contains("same as copy.png"));
    assert!(reason(&found, "shaken.png").contains("blurred"));
    assert!(reason(&found, "broken.jpg").contains("broken.jpg"));
    for name in ["empty.jpg", "text.jpg"] {
        reason(&found, name);
    }
    for (name, there) in
        [("copy.png", true), ("view00.png", false), ("shaken.png", false), ("broken.jpg", false)]
    {
        assert_eq!(set.beside("images").join(name).is_file(), there, "{name}");
    }
    let all = prepare(&set, true).unwrap();
    assert_eq!((all.photographs.len(), all.dropped.len()), (10, 3));
}

#[test]
fn photographs_are_turned_and_grouped_by_camera() {
    let set = Set::new();
    let upright = picture(&views()[0]);
    let exif = |name: &str, picture: &image::RgbImage, orientation, focal| {
        jpeg_with_exif(&set.photographs().join(name), picture, orientation, focal);
    };
    exif("a.jpg", &upright, 1, 28);
    // Orientation 8: the picture has to be turned by 270 degrees, so it is stored turned by 90.
    let lying = rotate90(&picture(&views()[2]));
    exif("b.jpg", &lying, 8, 28);
    exif("c.jpg", &picture(&views()[4]), 1, 50);
    picture(&views()[6]).save(set.photographs().join("d.jpg")).unwrap();
    let found = prepare(&set, false).unwrap();
    let cameras: Vec<usize> = found.photographs.iter().map(|photograph| photograph.camera).collect();
    assert_eq!(cameras, [0, 0, 1, 2]);
    let turned: Vec<bool> = found.photographs.iter().map(|photograph| photograph.turned).collect();
    assert_eq!(turned, [false, true, false, false]);
    let focal: Vec<Option<f64>> = found.cameras.iter().map(|camera| camera.focal_pixels).collect();
    let expected = 28.0 / 36f64.hypot(24.0) * 240f64.hypot(180.0);
    assert!((focal[0].unwrap() - expected).abs() < 1e-9 && focal[2].is_none(), "{focal:?}");

    let written = image::open(set.beside("images/b.jpg")).unwrap().to_rgb8();
    assert_eq!(written.dimensions(), (240, 180));
    let difference = |a: &image::RgbImage, b: &image::RgbImage| {
        let sum: i64 =
            a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| (i64::from(*a) - i64::from(*b)).abs()).sum();
        sum as f64 / a.as_raw().len() as f64
    };
    // Compressed twice, it is not the same to the bit; upside down it would be far off.
    let expected = picture(&views()[2]);
    let (right, wrong) = (difference(&written, &expected), difference(&written, &rotate180(&expected)));
    assert!(right < 0.5 * wrong, "{right} {wrong}");
}

#[test]
fn folders_without_enough_photographs_are_refused() {
    let set = Set::new();
    let refused = |parts: &[&str]| {
        let message = prepare(&set, false).unwrap_err().to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "no {parts:?} in: {message}");
    };
    refused(&["photographs: no photographs found", "PNG or JPEG"]);
    std::fs::write(set.photographs().join("a.heic"), b"x").unwrap();
    refused(&["1 pictures in other formats", "convert"]);
    set.add("a.png", &picture(&views()[0]));
    refused(&["1 of 1 photographs can be used", "at least 2"]);
    for i in 0..6 {
        set.add(&format!("copy{i}.png"), &picture(&views()[0]));
    }
    refused(&["1 of 7 photographs", "copy0.png: looks the same as a.png", "and 2 more"]);
    let missing = list_photographs(Path::new("there/is/none")).unwrap_err();
    assert!(
        matches!(missing, Error::File { .. }) && missing.to_string().contains("there/is/none"),
        "{missing}"
    );
}
