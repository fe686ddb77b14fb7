//! Reading pictures and depth: exact cameras, undistortion, and files that are not what they should be.

use crate::folder::{Folder, chain, pose, three_frames};
use glam::DVec2;
use gs_scene::{Intrinsics, View};
use image::ImageEncoder as _;
use image::codecs::jpeg::JpegEncoder;
use image::{GrayAlphaImage, GrayImage, ImageBuffer, Luma, LumaA, Rgb, Rgba, RgbaImage};
use serde_json::{Value, json};
use view_data::{Distortion, Error, Lens};

/// One frame `0.png`, with the keys of `changes` on the file.
fn one_frame(changes: &Value) -> Folder {
    let folder = Folder::new();
    let mut file = json!({
        "w": 64, "h": 48, "fl_x": 60.0, "fl_y": 62.0, "cx": 31.0, "cy": 25.0,
        "frames": [{"file_path": "0.png", "transform_matrix": pose(0.0)}],
    });
    file.as_object_mut().unwrap().extend(changes.as_object().unwrap().clone());
    folder.json(&file);
    folder
}

fn load_one(folder: &Folder, size: Option<(usize, usize)>) -> view_data::Result<View> {
    Ok(folder.open()?.load_views(&[0], size)?.remove(0))
}

#[track_caller]
fn check_error(folder: &Folder, size: Option<(usize, usize)>, expected: &str) {
    let message = chain(&load_one(folder, size).err().unwrap());
    assert!(message.contains(expected), "{message:?} does not contain {expected:?}");
}

/// Writes `0.png`: a 16-bit picture of a function of the pixel centre.
fn write16(folder: &Folder, width: u32, height: u32, colour: impl Fn(DVec2) -> [f64; 3]) {
    let picture = ImageBuffer::from_fn(width, height, |x, y| {
        Rgb(colour(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).map(|v| (v * 65535.0).round() as u16))
    });
    picture.save(folder.path("0.png")).unwrap();
}

/// Calls `check` with the position of each pixel centre of a view, and its colour, `border` pixels left out.
fn for_pixels(view: &View, border: usize, mut check: impl FnMut(DVec2, [f32; 3])) {
    let image = view.image();
    for y in border..image.height() - border {
        for x in border..image.width() - border {
            check(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), image.pixel(x, y));
        }
    }
}

#[test]
fn pictures_come_as_they_are_stored_in_the_order_asked_for() {
    let folder = Folder::new();
    folder.json(&three_frames());
    for i in 0..3 {
        folder.picture(&format!("images/{i}.png"), 32, 24);
    }
    let dataset = folder.open().unwrap();
    let views = dataset.load_views(&[2, 0, 2], None).unwrap();
    assert_eq!(views.iter().map(View::name).collect::<Vec<_>>(), ["2", "0", "2"]);
    let stored = image::open(folder.path("images/2.png")).unwrap().into_rgb8();
    assert_eq!(&views[0].image().to_rgb8(), stored.as_raw());
    assert_eq!(views[0].camera(), &dataset.frames[2].camera().unwrap());
    assert!(views[0].depth().is_none());
    assert!(dataset.load_views(&[], None).unwrap().is_empty());
    let message = dataset.load_views(&[1, 3], None).unwrap_err().to_string();
    assert!(message.starts_with("frame position 3 does not exist") && message.ends_with("3 frames (0 to 2)"));
}

#[test]
fn every_kind_of_pixel_becomes_rgb() {
    let folder = one_frame(&json!({"w": 2, "h": 1}));
    let path = folder.path("0.png");
    let first = || load_one(&folder, None).unwrap().image().pixel(0, 0);
    GrayImage::from_pixel(2, 1, Luma([51])).save(&path).unwrap();
    assert_eq!(first(), [0.2; 3]);
    ImageBuffer::from_pixel(2, 1, Luma([13107_u16])).save(&path).unwrap();
    assert_eq!(first(), [0.2; 3]);
    RgbaImage::from_pixel(2, 1, Rgba([255, 102, 0, 51])).save(&path).unwrap();
    assert!(first().iter().zip([0.2, 0.08, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6));
    GrayAlphaImage::from_pixel(2, 1, LumaA([255, 0])).save(&path).unwrap();
    assert_eq!(first(), [0.0; 3]);
    // The content decides, not the extension.
    GrayImage::from_pixel(2, 1, Luma([51])).save_with_format(&path, image::ImageFormat::Jpeg).unwrap();
    assert!((first()[0] - 0.2).abs() < 0.01);
}

#[test]
fn intrinsics_follow_the_size_of_the_file() {
    let folder = one_frame(&json!({}));
    folder.picture("0.png", 32, 24);
    let half = Intrinsics { fx: 30.0, fy: 31.0, cx: 15.5, cy: 12.5, width: 32, height: 24 };
    assert_eq!(*load_one(&folder, None).unwrap().camera().intrinsics(), half);
    folder.picture("0.png", 48, 64);
    check_error(&folder, None, "0.png: picture is 48x64, but the intrinsics are for 64x48");
}

/// A JPEG with a light left half, 64x48, whose EXIF data ask for a turn: EXIF's number of the orientation.
fn write_turned(folder: &Folder, orientation: u8) {
    let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    write_with_exif(folder, exif);
}

fn write_with_exif(folder: &Folder, exif: Vec<u8>) {
    let picture = GrayImage::from_fn(64, 48, |x, _| Luma([if x < 32 { 230 } else { 20 }]));
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    picture.write_with_encoder(encoder).unwrap();
    std::fs::write(folder.path("0.png"), bytes).unwrap();
}

#[test]
fn exif_turns_a_picture_only_into_the_shape_that_is_stated() {
    let stored = one_frame(&json!({}));
    let upright = one_frame(&json!({"w": 48, "h": 64, "cx": 25.0, "cy": 31.0}));
    for orientation in 1..=8 {
        write_turned(&stored, orientation);
        let view = load_one(&stored, None).unwrap();
        assert_eq!((view.image().width(), view.image().height()), (64, 48));
        assert!(view.image().pixel(3, 20)[0] > 0.8 && view.image().pixel(60, 20)[0] < 0.2);
        assert_eq!(stored.open().unwrap().frames[0].picture_size().unwrap(), (64, 48));

        write_turned(&upright, orientation);
        if orientation < 5 {
            check_error(&upright, None, "0.png: picture is 64x48, but the intrinsics are for 48x64");
            continue;
        }
        let view = load_one(&upright, None).unwrap();
        assert_eq!((view.image().width(), view.image().height()), (48, 64));
        assert_eq!(upright.open().unwrap().frames[0].picture_size().unwrap(), (48, 64));
        // The stored left side becomes the upper one with 5 and 6, the lower one with 7 and 8.
        let (upper, lower) = (view.image().pixel(20, 3)[0], view.image().pixel(20, 60)[0]);
        assert!(if orientation < 7 { upper > 0.8 && lower < 0.2 } else { lower > 0.8 && upper < 0.2 });
    }
}

#[test]
fn exif_data_that_say_nothing_turn_nothing() {
    let upright = one_frame(&json!({"w": 48, "h": 64, "cx": 25.0, "cy": 31.0}));
    for orientation in [0, 9, 255] {
        write_turned(&upright, orientation);
        check_error(&upright, None, "0.png: picture is 64x48, but the intrinsics are for 48x64");
    }
    // A block that ends within its directory.
    write_with_exif(&upright, b"II*\0\x08\0\0\0\x01\0\x12".to_vec());
    check_error(&upright, None, "0.png: picture is 64x48, but the intrinsics are for 48x64");
}

/// Colours that are linear in the pixel position tell where in the source a pixel was sampled.
#[test]
fn resizing_and_cutting_keep_the_camera_exact() {
    let folder = one_frame(&json!({"w": 120, "h": 80}));
    write16(&folder, 120, 80, |p| [p.x / 120.0, p.y / 80.0, 0.5]);
    let lens = folder.open().unwrap().frames[0].lens.intrinsics;
    // Down, up, cut left and right, cut above and below, one axis barely changed.
    for (width, height) in [(60, 40), (180, 120), (40, 40), (60, 20), (119, 80), (31, 17), (120, 80)] {
        let view = load_one(&folder, Some((width, height))).unwrap();
        let camera = view.camera().intrinsics();
        assert_eq!((camera.width, camera.height), (width, height));
        for_pixels(&view, 6, |position, colour| {
            let ray = camera.ray(position);
            let source = DVec2::new(lens.fx * ray.x + lens.cx, lens.fy * ray.y + lens.cy);
            let found = DVec2::new(f64::from(colour[0]) * 120.0, f64::from(colour[1]) * 80.0);
            // Lanczos-3 reproduces a ramp to some hundredths of a pixel.
            assert!((found - source).length() < 0.05, "{width}x{height} {position}: {found} {source}");
            assert!((colour[2] - 0.5).abs() < 1e-4);
        });
    }
}

/// A lens of 64×48 pixels; `sign` +1 spreads the picture, -1 draws it in.
fn distorted_lens(sign: f64) -> Lens {
    let intrinsics = Intrinsics { fx: 60.0, fy: 62.0, cx: 31.0, cy: 25.0, width: 64, height: 48 };
    let distortion = Distortion { k1: 0.2 * sign, k2: 0.05 * sign, k3: 0.01, p1: 0.003, p2: -0.002 };
    Lens { intrinsics, model: distortion.into() }
}

fn distorted_folder(lens: Lens, more: &Value) -> Folder {
    let Distortion { k1, k2, k3, p1, p2 } = *lens.model.radial_tangential().unwrap();
    let mut file = json!({"k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2});
    file.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    one_frame(&file)
}

/// Colours that are linear in the undistorted direction tell in which direction a pixel looks.
#[test]
fn undistorted_pixels_look_where_their_camera_says_and_none_shows_what_was_not_seen() {
    for (sign, smaller) in [(1.0, true), (-1.0, false)] {
        let lens = distorted_lens(sign);
        let folder = distorted_folder(lens, &json!({}));
        write16(&folder, 64, 48, |p| {
            let d = lens.undistort(p).unwrap();
            [0.5 + 0.6 * d.x, 0.5 + 0.6 * d.y, 0.25]
        });
        for size in [None, Some((32, 24))] {
            let view = load_one(&folder, size).unwrap();
            let camera = view.camera().intrinsics();
            if size.is_none() {
                assert_eq!((camera.fx, camera.fy), (60.0, 62.0));
                assert_eq!((camera.width, camera.height) != (64, 48), smaller, "{camera:?}");
                assert!(camera.width >= 56 && camera.height >= 42, "{camera:?}");
            }
            for_pixels(&view, if size.is_some() { 5 } else { 0 }, |position, colour| {
                let ray = camera.ray(position);
                let seen = (DVec2::new(f64::from(colour[0]), f64::from(colour[1])) - 0.5) / 0.6;
                // 1e-3 is 0.06 px; the border pixels are interpolated with a repeated neighbour.
                let edge = position.x < 3.0 || position.y < 3.0;
                let edge =
                    edge || position.x > camera.width as f64 - 3.0 || position.y > camera.height as f64 - 3.0;
                let tolerance = if edge { 4e-3 } else { 1e-3 };
                assert!(
                    (seen - ray.truncate()).length() < tolerance,
                    "{sign} {size:?} {position} {seen} {ray}"
                );
            });
        }
    }
}

#[test]
fn a_fisheye_picture_becomes_a_pinhole_of_its_middle_and_half_a_sphere_is_refused() {
    let fisheye = |focal: f64| {
        json!({"camera_model": "OPENCV_FISHEYE", "fl_x": focal, "fl_y": focal, "k1": 0.02, "k2": -0.005,
            "cx": 32.0, "cy": 24.0})
    };
    let folder = one_frame(&fisheye(30.0));
    let lens = folder.open().unwrap().frames[0].lens;
    write16(&folder, 64, 48, |p| {
        let d = lens.undistort(p).unwrap();
        // By the angle: directions at the corners of this picture grow too long to be colours.
        [0.5 + 0.3 * d.x.atan(), 0.5 + 0.3 * d.y.atan(), 0.25]
    });
    let view = load_one(&folder, None).unwrap();
    let camera = view.camera().intrinsics();
    assert_eq!((camera.fx, camera.width, camera.height), (30.0, 64, 48));
    for_pixels(&view, 2, |position, colour| {
        let ray = camera.ray(position);
        let expected = [0.5 + 0.3 * ray.x.atan(), 0.5 + 0.3 * ray.y.atan()];
        for (found, expected) in colour.into_iter().zip(expected) {
            assert!((f64::from(found) - expected).abs() < 1e-3, "{position} {found} {expected}");
        }
    });
    // 18 pixels per radian: before the border, 31.5 pixels from the middle, lie 90 degrees.
    let folder = one_frame(&fisheye(18.0));
    folder.picture("0.png", 64, 48);
    check_error(&folder, None, "0.png: lens sees 180 degrees or more");
}

#[test]
fn depth_is_the_nearest_measurement_in_its_unit() {
    // A plane z = 2 m but for a hole at the left, and a picture of half the depth's size.
    for (unit, scale) in [(Value::Null, 0.001), (json!(0.01), 0.01)] {
        let folder = one_frame(&json!({"depth_unit_scale_factor": unit,
            "frames": [{"file_path": "0.png", "depth_file_path": "0_depth.png", "transform_matrix": pose(0.0)}]}));
        folder.picture("0.png", 64, 48);
        folder.depth("0_depth.png", 128, 96, |x, y| if x < 64 { 0 } else { 2000 + y as u16 });
        let view = load_one(&folder, None).unwrap();
        let depth = view.depth().unwrap();
        assert_eq!((depth.width(), depth.height(), depth.coverage()), (64, 48, 0.5));
        // Row 10 of the view is centred on the border of rows 20 and 21; the later one counts as nearest.
        assert_eq!(depth.data()[10 * 64 + 40], (2021.0 * scale) as f32);
        // Cut to 24 columns from the middle, doubled: 12 columns of the source, half of them in the hole.
        let view = load_one(&folder, Some((24, 96))).unwrap();
        assert_eq!(view.depth().unwrap().coverage(), 0.5);
    }
}

#[test]
fn depth_is_undistorted_with_its_picture() {
    let lens = distorted_lens(1.0);
    let frame = json!({"file_path": "0.png", "depth_file_path": "d.png", "transform_matrix": pose(0.0)});
    let folder = distorted_folder(lens, &json!({"frames": [frame]}));
    folder.picture("0.png", 64, 48);
    // Counts that tell the undistorted direction: 10 000 + 10 000 x.
    folder.depth("d.png", 64, 48, |x, y| {
        let d = lens.undistort(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).unwrap();
        (10_000.0 + 10_000.0 * d.x).round() as u16
    });
    let view = load_one(&folder, None).unwrap();
    let camera = view.camera().intrinsics();
    for (i, &depth) in view.depth().unwrap().data().iter().enumerate() {
        let pixel = DVec2::new((i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5);
        // Nearest sampling is at most half a pixel off, 0.5/60, in either axis; the lens magnifies little.
        let expected = 10.0 + 10.0 * camera.ray(pixel).x;
        assert!((f64::from(depth) - expected).abs() < 10.0 * 0.6 / 60.0, "{pixel} {depth} {expected}");
    }
}

#[test]
fn files_that_are_not_what_they_should_be() {
    let folder = one_frame(&json!({}));
    check_error(&folder, None, "0.png: picture of frame 0 is missing");
    std::fs::write(folder.path("0.png"), b"").unwrap();
    check_error(&folder, None, "0.png: picture cannot be decoded");
    std::fs::write(folder.path("0.png"), b"GIF89a and so on").unwrap();
    check_error(&folder, None, "0.png: picture cannot be decoded");
    std::fs::remove_file(folder.path("0.png")).unwrap();
    std::fs::create_dir(folder.path("0.png")).unwrap();
    check_error(&folder, None, "0.png: cannot read");

    let frame = json!({"file_path": "0.png", "depth_file_path": "d.png", "transform_matrix": pose(0.0)});
    let folder = one_frame(&json!({"frames": [frame]}));
    folder.picture("0.png", 64, 48);
    check_error(&folder, None, "d.png: picture of frame 0 is missing");
    folder.picture("d.png", 64, 48);
    check_error(&folder, None, "d.png: depth is a picture of type Rgb8, expected a 16-bit greyscale PNG");
    folder.depth("d.png", 48, 64, |_, _| 1);
    check_error(&folder, None, "d.png: picture is 48x64");
}

#[test]
fn truncated_pictures_are_errors_wherever_they_end() {
    let folder = one_frame(&json!({}));
    for extension in ["png", "jpg"] {
        folder.picture(&format!("whole.{extension}"), 64, 48);
        let whole = std::fs::read(folder.path(&format!("whole.{extension}"))).unwrap();
        // The last 12 bytes of a PNG are its empty end chunk: without them the picture is complete.
        let end = whole.len() - if extension == "png" { 12 } else { 0 };
        for cut in (0..end).step_by(7).chain([end - 1]) {
            std::fs::write(folder.path("0.png"), &whole[..cut]).unwrap();
            let message = chain(&load_one(&folder, None).unwrap_err());
            assert!(message.contains("0.png: "), "{extension} {cut}: {message}");
        }
        std::fs::write(folder.path("0.png"), [&whole, b"trailing".as_slice()].concat()).unwrap();
        assert!(load_one(&folder, None).is_ok());
    }
}

#[test]
fn a_header_that_promises_too_much_allocates_nothing() {
    let folder = one_frame(&json!({}));
    folder.picture("whole.png", 64, 48);
    let mut bytes = std::fs::read(folder.path("whole.png")).unwrap();
    // Width and height follow the chunk's name; its check sum is not looked at before the size.
    bytes[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    std::fs::write(folder.path("0.png"), bytes).unwrap();
    assert!(load_one(&folder, None).is_err());
}

#[test]
fn target_sizes_are_checked() {
    let folder = one_frame(&json!({}));
    folder.picture("0.png", 64, 48);
    check_error(&folder, Some((0, 5)), "target size is 0x5, expected at least one");
    check_error(&folder, Some((usize::MAX, 2)), "target size is");
    check_error(&folder, Some((100_000, 1)), "0.png resized is 100000x75000");
    assert_eq!(load_one(&folder, Some((1, 1))).unwrap().image().width(), 1);
}

#[test]
fn lenses_that_fold_or_leave_nothing_are_refused() {
    // At the picture's border x = 0.5, where x (1 - 2 x²) has turned back.
    let folder = one_frame(&json!({"k1": -2.0}));
    folder.picture("0.png", 64, 48);
    check_error(&folder, None, "0.png: lens distortion folds at pixel (");
    for absurd in [1e300, -1e300, 1e6] {
        let folder = one_frame(&json!({"k1": absurd}));
        folder.picture("0.png", 64, 48);
        assert!(load_one(&folder, None).is_err(), "{absurd}");
    }
}

#[test]
fn different_sizes_ask_for_one() {
    let folder = Folder::new();
    folder.json(&three_frames());
    folder.picture("images/0.png", 32, 24);
    folder.picture("images/1.png", 32, 24);
    folder.picture("images/2.png", 64, 48);
    let dataset = folder.open().unwrap();
    let message = dataset.load_views(&[0, 1, 2], None).unwrap_err().to_string();
    assert_eq!(
        message,
        "views have different sizes: 1 is 32x24, 2 is 64x48; ask for one size, to which all are scaled and cropped"
    );
    assert_eq!(dataset.load_views(&[0, 1, 2], Some((16, 16))).unwrap().len(), 3);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let folder = Folder::new();
    let mut file = three_frames();
    file["k1"] = json!(0.1);
    folder.json(&file);
    for i in 0..3 {
        folder.picture(&format!("images/{i}.png"), 32, 24);
    }
    let dataset = folder.open().unwrap();
    let load = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let views = pool.install(|| dataset.load_views(&[0, 1, 2], Some((21, 13)))).unwrap();
        views.into_iter().map(|view| view.image().data().to_vec()).collect::<Vec<_>>()
    };
    assert_eq!(load(1), load(3));
    // The first error in the order asked for, however the work is divided.
    for path in ["images/1.png", "images/2.png"] {
        std::fs::remove_file(folder.path(path)).unwrap();
    }
    for _ in 0..20 {
        let error = dataset.load_views(&[2, 0, 1], None).unwrap_err();
        assert!(matches!(error, Error::MissingPicture { frame, .. } if frame == "2"));
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_or_endless_is_refused_at_once() {
    let frame = json!({"file_path": "0.png", "depth_file_path": "d.exr", "transform_matrix": pose(0.0)});
    let folder = one_frame(&json!({ "frames": [frame] }));
    folder.picture("0.png", 64, 48);
    let fifo = std::process::Command::new("mkfifo").arg(folder.path("d.exr")).status().unwrap();
    assert!(fifo.success());
    check_error(&folder, None, "d.exr: cannot read: it is no regular file");
    std::fs::remove_file(folder.path("d.exr")).unwrap();
    std::fs::write(folder.path("d.exr"), "garbage").unwrap();
    check_error(&folder, None, "d.exr: depth is a file that does not begin as EXR files do");
    std::fs::remove_file(folder.path("d.exr")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", folder.path("d.exr")).unwrap();
    check_error(&folder, None, "d.exr: cannot read: it is no regular file");

    // A file that promises 20 GiB and holds nothing.
    let sparse = std::fs::File::create(folder.path("0.png")).unwrap();
    if sparse.set_len(20 << 30).is_ok() {
        check_error(
            &folder,
            None,
            "0.png: cannot read: it has 21474836480 bytes, expected at most 1073741824",
        );
    }
    std::fs::remove_file(folder.path("transforms.json")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", folder.path("transforms.json")).unwrap();
    assert!(folder.open_error().ends_with("it is no regular file"));
}
