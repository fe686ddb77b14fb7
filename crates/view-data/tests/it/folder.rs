//! Small data sets in temporary folders.

use image::{ImageBuffer, Luma, Rgb, RgbImage};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A temporary folder that becomes a data set.
pub(crate) struct Folder(TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn root(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        let path = self.root().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }

    /// Writes `transforms.json`.
    pub(crate) fn json(&self, value: &Value) {
        self.text(&value.to_string());
    }

    pub(crate) fn text(&self, text: &str) {
        std::fs::write(self.path("transforms.json"), text).unwrap();
    }

    /// Writes a picture whose colour tells the pixel, in the format of its extension.
    pub(crate) fn picture(&self, name: &str, width: u32, height: u32) {
        let at = |x: u32, y: u32| Rgb([(x * 5 % 256) as u8, (y * 7 % 256) as u8, 90]);
        RgbImage::from_fn(width, height, at).save(self.path(name)).unwrap();
    }

    /// Writes a 16-bit depth PNG.
    pub(crate) fn depth(&self, name: &str, width: u32, height: u32, count: impl Fn(u32, u32) -> u16) {
        let picture = ImageBuffer::from_fn(width, height, |x, y| Luma([count(x, y)]));
        picture.save(self.path(name)).unwrap();
    }

    pub(crate) fn open(&self) -> view_data::Result<view_data::Dataset> {
        view_data::open_nerfstudio(self.root())
    }

    /// The message of the error that opening gives, its causes after colons.
    pub(crate) fn open_error(&self) -> String {
        chain(&self.open().unwrap_err())
    }
}

/// An error and its causes in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// Camera at (`x`, 0, 0), which looks along the world's +z with y down: the OpenGL axes are flipped.
pub(crate) fn pose(x: f64) -> Value {
    json!([[1.0, 0.0, 0.0, x], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
}

/// A valid file of three frames `images/{0,1,2}.png`, 32×24; the pictures are not written.
pub(crate) fn three_frames() -> Value {
    let frame =
        |i: u32| json!({"file_path": format!("images/{i}.png"), "transform_matrix": pose(f64::from(i))});
    json!({
        "camera_model": "OPENCV", "w": 32, "h": 24, "fl_x": 40.0, "fl_y": 41.0, "cx": 15.5, "cy": 12.5,
        "frames": [frame(0), frame(1), frame(2)],
    })
}
