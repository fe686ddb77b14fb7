//! The public interface: round trips with bounds from each format's rounding, hostile files, recognition by content.

mod glb;
mod hostile;
mod round_trip;

use gs_scene::{Gaussians, sh_coefficients};
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

/// `n` Gaussians within the ranges of all formats, drawn from a seed.
fn scene(degree: usize, n: usize, seed: u64) -> Gaussians {
    let mut state = seed;
    // SplitMix64, from -1 to 1.
    let mut draw = move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    let mut scene = Gaussians::empty(degree).unwrap();
    for _ in 0..n {
        let mean = [0; 3].map(|_| 30.0 * draw());
        let quaternion = loop {
            let q = [0; 4].map(|_| draw());
            if q.iter().map(|v| v * v).sum::<f32>() > 1e-4 {
                break q;
            }
        };
        let log_scale = [0; 3].map(|_| 6.0 * draw() - 2.0);
        let opacity = 8.0 * draw();
        let mut sh: Vec<f32> = (0..sh_coefficients(degree) * 3).map(|_| 0.95 * draw()).collect();
        // Colours from 0 to 1.
        sh[..3].iter_mut().for_each(|value| *value *= 0.5 / gs_scene::SH_C0);
        scene.push(mean, quaternion, log_scale, opacity, &sh);
    }
    scene
}

/// Files of every format, by name.
fn files(gaussians: &Gaussians) -> Vec<(Format, String, Vec<u8>)> {
    Format::ALL.map(|f| (f, format!("x.{}", f.extension()), encoded(gaussians, f))).to_vec()
}

fn extension(path: &str) -> Option<Format> {
    Format::of_path(Path::new(path))
}
