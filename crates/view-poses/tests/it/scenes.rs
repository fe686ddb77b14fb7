//! Simulated photographs as files without poses.

use glam::DVec3;
use gs_scene::{Camera, View};
use image::RgbImage;
use scene_sim::{Traced, demo_scene, lens, render_view};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

pub(crate) const WIDTH: usize = 240;
pub(crate) const HEIGHT: usize = 180;
/// Degrees.
const FIELD: f64 = 62.0;

/// A camera of the courtyard on a path that bends.
#[cfg_attr(not(feature = "openmvg"), allow(dead_code, reason = "only poses are compared with it"))]
pub(crate) fn camera(i: usize) -> Camera {
    let t = i as f64;
    let angle = (-132.0 + 4.0 * t).to_radians();
    let radius = 4.3 + 0.3 * (1.9 * t).sin();
    let position =
        DVec3::new(0.4 + radius * angle.cos(), 0.9 + radius * angle.sin(), 1.7 + 0.25 * (1.3 * t).sin());
    Camera::looking_at(lens(WIDTH, HEIGHT, FIELD), position, DVec3::new(0.4, 0.9, 0.95), DVec3::Z).unwrap()
}

pub(crate) fn courtyard() -> &'static Traced {
    static SCENE: OnceLock<Traced> = OnceLock::new();
    SCENE.get_or_init(|| Traced::new(&demo_scene()).unwrap())
}

/// Eight photographs of the courtyard, rendered once.
pub(crate) fn views() -> &'static [View] {
    static VIEWS: OnceLock<Vec<View>> = OnceLock::new();
    VIEWS.get_or_init(|| {
        (0..8).map(|i| render_view(courtyard(), &camera(i), 4, format!("view{i:02}"), 0).unwrap()).collect()
    })
}

pub(crate) fn picture(view: &View) -> RgbImage {
    let image = view.image();
    RgbImage::from_raw(image.width() as u32, image.height() as u32, image.to_rgb8()).unwrap()
}

/// A folder for photographs, and beside it one for results.
pub(crate) struct Set {
    folder: TempDir,
}

impl Set {
    pub(crate) fn new() -> Self {
        let set = Self { folder: tempfile::tempdir().unwrap() };
        std::fs::create_dir(set.photographs()).unwrap();
        set
    }

    /// The eight photographs.
    pub(crate) fn of_views() -> Self {
        let set = Self::new();
        for view in views() {
            set.add(&format!("{}.png", view.name()), &picture(view));
        }
        set
    }

    pub(crate) fn add(&self, name: &str, picture: &RgbImage) {
        picture.save(self.photographs().join(name)).unwrap();
    }

    pub(crate) fn photographs(&self) -> PathBuf {
        self.folder.path().join("photographs")
    }

    pub(crate) fn beside(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

/// Writes a JPEG with EXIF data: orientation, and a focal length of 35 mm equivalent.
pub(crate) fn jpeg_with_exif(path: &Path, picture: &RgbImage, orientation: u16, focal_35: u16) {
    let mut plain = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut plain, image::ImageFormat::Jpeg).unwrap();
    let plain = plain.into_inner();
    // TIFF, big-endian: one directory with an orientation and a pointer to the directory with the focal length.
    let entry = |tag: u16, kind: u16, value: u32| -> Vec<u8> {
        let value = if kind == 3 { value << 16 } else { value };
        [&tag.to_be_bytes()[..], &kind.to_be_bytes(), &1u32.to_be_bytes(), &value.to_be_bytes()].concat()
    };
    let first = [entry(0x112, 3, orientation.into()), entry(0x8769, 4, 8 + 2 + 24 + 4)].concat();
    let second = entry(0xa405, 3, focal_35.into());
    let directory = |entries: &[u8]| {
        [&((entries.len() / 12) as u16).to_be_bytes()[..], entries, &0u32.to_be_bytes()].concat()
    };
    let tiff = [&b"MM\0\x2a\0\0\0\x08"[..], &directory(&first), &directory(&second)].concat();
    let body = [&b"Exif\0\0"[..], &tiff].concat();
    let segment = [&[0xff, 0xe1][..], &((body.len() + 2) as u16).to_be_bytes(), &body].concat();
    std::fs::write(path, [&plain[..2], &segment, &plain[2..]].concat()).unwrap();
}
