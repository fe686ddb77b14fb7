//! The public interface: round trips with bounds from each format's rounding, hostile files, recognition by content.

#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

mod difference;
mod glb;
mod hostile;
mod round_trip;

use difference::scene;
use gs_scene::Gaussians;
use splat_formats::{Encoder, Format, Scene, read_scene};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A folder that goes when it is dropped.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes bytes and reads them as a scene.
    fn read(&self, name: &str, bytes: &[u8]) -> splat_formats::Result<Scene> {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        read_scene(&path)
    }

    /// The message for bytes that are refused, without the folder.
    fn refused(&self, name: &str, bytes: &[u8]) -> String {
        let message = self.read(name, bytes).expect_err("the file is refused").to_string();
        let start = format!("{}: ", self.path(name).display());
        message.strip_prefix(&start).expect("the error names the file").to_owned()
    }
}

fn encoded(gaussians: &Gaussians, format: Format) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(gaussians, format).unwrap().encode(&mut bytes).unwrap();
    bytes
}

/// Files of every format, by name.
fn files(gaussians: &Gaussians) -> Vec<(Format, String, Vec<u8>)> {
    Format::ALL.map(|f| (f, format!("x.{}", f.extension()), encoded(gaussians, f))).to_vec()
}

fn extension(path: &str) -> Option<Format> {
    Format::of_path(Path::new(path))
}
