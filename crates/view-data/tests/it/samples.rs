//! A small valid data set in every layout, shared by tests and by the example that mutates them.

use std::path::{Path, PathBuf};
use view_data::Format;

/// Writes a data set; every call the same bytes. Returns what to open.
pub(crate) fn write(format: Format, variant: &str, root: &Path) -> PathBuf {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
    match format {
        Format::Nerfstudio => nerfstudio(root),
        Format::Colmap => {
            copy(&fixtures.join("colmap").join(variant), &root.join("sparse/0"));
            for name in ["b", "c", "left/a", "right/a"] {
                picture(&root.join(format!("images/{name}.png")), 64, 48);
            }
        }
        Format::Replica => replica(root),
        Format::Tum => tum(root),
        Format::ScanNet => scannet(root),
        Format::Dl3dv => dl3dv(root),
        Format::Re10k => re10k(root),
        _ => copy(&fixtures.join("chunks"), root),
    }
    root.to_path_buf()
}

/// Layouts and their variants.
#[allow(dead_code, reason = "of those that share this file some name layouts one by one")]
pub(crate) const ALL: [(Format, &str); 9] = [
    (Format::Nerfstudio, ""),
    (Format::Colmap, "bin"),
    (Format::Colmap, "txt"),
    (Format::Replica, ""),
    (Format::Tum, ""),
    (Format::ScanNet, ""),
    (Format::Chunk, ""),
    (Format::Dl3dv, ""),
    (Format::Re10k, ""),
];

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() && path.extension().is_some_and(|extension| extension != "py" && extension != "md")
        {
            std::fs::copy(&path, to.join(path.file_name().unwrap())).unwrap();
        }
    }
}

pub(crate) fn text(path: &Path, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

pub(crate) fn picture(path: &Path, width: u32, height: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let at = |x: u32, y: u32| image::Rgb([(x * 5 % 256) as u8, (y * 7 % 256) as u8, 90]);
    image::RgbImage::from_fn(width, height, at).save(path).unwrap();
}

/// 16-bit depth.
pub(crate) fn depth(path: &Path, width: u32, height: u32, count: impl Fn(u32, u32) -> u16) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let picture = image::ImageBuffer::from_fn(width, height, |x, y| image::Luma([count(x, y)]));
    picture.save(path).unwrap();
}

/// An EXR file of one channel of 32-bit floats.
pub(crate) fn exr(
    path: &Path,
    channel: &str,
    (width, height): (usize, usize),
    value: impl Fn(usize, usize) -> f32 + Sync,
) {
    use exr::prelude::{Encoding, Image, SpecificChannels, WritableImage};
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let channels = SpecificChannels::build()
        .with_channel(channel)
        .with_pixel_fn(|position: exr::prelude::Vec2<usize>| (value(position.0, position.1),));
    let image = Image::from_encoded_channels((width, height), Encoding::FAST_LOSSLESS, channels);
    image.write().non_parallel().to_file(path).unwrap();
}

fn nerfstudio(root: &Path) {
    text(
        &root.join("transforms.json"),
        r#"{"camera_model": "OPENCV", "w": 32, "h": 24, "fl_x": 40.0, "fl_y": 41.0, "cx": 15.5, "cy": 12.5,
            "k1": 0.05, "ply_file_path": "points.ply", "applied_scale": 0.5,
            "frames": [
              {"file_path": "images/0.png", "depth_file_path": "depth/0.png",
               "transform_matrix": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]},
              {"file_path": "images/1.jpg", "depth_file_path": "depth/1.exr",
               "transform_matrix": [[1, 0, 0, 1], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]}]}"#,
    );
    picture(&root.join("images/0.png"), 32, 24);
    picture(&root.join("images/1.jpg"), 32, 24);
    depth(&root.join("depth/0.png"), 32, 24, |x, _| 1000 + x as u16);
    exr(&root.join("depth/1.exr"), "Z", (32, 24), |x, y| x as f32 + 0.5 * y as f32);
    text(
        &root.join("points.ply"),
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 4 5 6\n7 8 9 10 11 12\n",
    );
}

/// Five frames of a camera at (i, 0, 0) that looks along +z.
fn replica(root: &Path) {
    let scene = root.join("room0");
    text(
        &root.join("cam_params.json"),
        r#"{"camera": {"w": 64, "h": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "scale": 6553.5}}"#,
    );
    let line = |i: usize| format!("1.0 0 0 {i}.0e+00 0 1 0 0 0 0 1 0 0 0 0 1\n");
    text(&scene.join("traj.txt"), &(0..5).map(line).collect::<String>());
    for i in 0..5 {
        picture(&scene.join(format!("results/frame{i:06}.jpg")), 64, 48);
        let count = move |x: u32, _: u32| {
            if x == 0 {
                0
            } else if x == 1 {
                65535
            } else {
                13107
            }
        };
        depth(&scene.join(format!("results/depth{i:06}.png")), 64, 48, count);
    }
}

fn tum(root: &Path) {
    let scene = root.join("rgbd_dataset_freiburg3_desk");
    let mut lists = [String::from("# colour\n"), String::from("# depth\n"), String::from("# poses\n")];
    for i in 0..4 {
        let time = 100.0 + 0.1 * f64::from(i);
        lists[0] += &format!("{time:.4} rgb/{time:.4}.png\n");
        lists[1] += &format!("{:.4} depth/{time:.4}.png\n", time + 0.011);
        lists[2] += &format!("{:.4} {i} 0 0 0 0 0 1\n", time - 0.004);
        picture(&scene.join(format!("rgb/{time:.4}.png")), 64, 48);
        depth(&scene.join(format!("depth/{time:.4}.png")), 64, 48, |_, y| if y == 0 { 0 } else { 10_000 });
    }
    for (name, list) in ["rgb.txt", "depth.txt", "groundtruth.txt"].iter().zip(&lists) {
        text(&scene.join(name), list);
    }
}

fn scannet(root: &Path) {
    let matrix = |f: f64, cx: f64, cy: f64| format!("{f} 0 {cx} 0\n0 {f} {cy} 0\n0 0 1 0\n0 0 0 1\n");
    text(&root.join("intrinsic/intrinsic_color.txt"), &matrix(60.0, 31.5, 23.5));
    // The depth camera sees a little less to each side.
    text(&root.join("intrinsic/intrinsic_depth.txt"), &matrix(33.0, 15.5, 11.5));
    for i in [0, 2, 10, 11] {
        picture(&root.join(format!("color/{i}.jpg")), 64, 48);
        depth(&root.join(format!("depth/{i}.png")), 32, 24, |x, _| 1000 + x as u16);
        let lost = i == 10;
        let entry = if lost { "-inf".to_owned() } else { format!("{i}.5") };
        text(&root.join(format!("pose/{i}.txt")), &format!("1 0 0 {entry}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"));
    }
}

fn dl3dv(root: &Path) {
    let home = root.join("1K").join("5a".repeat(32));
    let frame = |number: u32| {
        picture(&home.join(format!("images_4/frame_{number:05}.png")), 32, 18);
        format!(
            r#"{{"file_path": "images/frame_{number:05}.png",
                "transform_matrix": [[1, 0, 0, {number}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}"#
        )
    };
    let frames = [frame(7), frame(1), frame(4)].join(", ");
    let lens =
        r#""w": 128, "h": 72, "fl_x": 100.0, "fl_y": 100.5, "cx": 64.0, "cy": 36.0, "k1": 0.01, "p2": 0.0"#;
    text(
        &home.join("transforms.json"),
        &format!(r#"{{"camera_model": "OPENCV", {lens}, "frames": [{frames}]}}"#),
    );
}

fn re10k(root: &Path) {
    let mut lines = String::from("https://example.invalid/watch?v=x\n");
    for number in 0..3 {
        let stamp = 1_000_000 + number * 33_366;
        picture(&root.join(format!("test/00a1/{stamp}.png")), 40, 20);
        lines += &format!(
            "{stamp} 0.5 0.75 0.5 0.4 0.0 0.0 1.0 0.0 0.0 -{number} 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0\n"
        );
    }
    text(&root.join("test/00a1.txt"), &lines);
}
