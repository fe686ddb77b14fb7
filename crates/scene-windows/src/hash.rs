//! The hash that identifies a set of views.

use crate::Window;
use gs_scene::{DepthMap, View};
use sha2::{Digest, Sha256};
use std::path::Path;

impl Window {
    /// SHA-256 of the views as they went into the figures: cameras and pictures, context first; and of how many are context. Equal
    /// for equal data, whatever its files and their names.
    #[must_use]
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update((self.context.len() as u64).to_le_bytes());
        for view in self.context.iter().chain(&self.targets) {
            add_camera(&mut hash, view);
            hash.update(view.image().to_rgb8());
        }
        hexadecimal(&hash.finalize())
    }

    /// SHA-256 of everything that a method or a training could see: cameras, and pictures and depth to the last bit.
    #[must_use]
    pub fn exact_sha256(&self) -> String {
        sha256_of(
            [of_views("context", &self.context), of_views("targets", &self.targets)]
                .iter()
                .map(String::as_str),
        )
    }
}

/// SHA-256 of a file.
///
/// # Errors
/// If it cannot be read.
pub fn file_sha256(path: &Path) -> std::io::Result<String> {
    Ok(hexadecimal(&Sha256::digest(std::fs::read(path)?)))
}

/// SHA-256 of several hashes in their order.
pub fn sha256_of<'a>(hashes: impl Iterator<Item = &'a str>) -> String {
    let mut all = Sha256::new();
    hashes.for_each(|hash| all.update(hash.as_bytes()));
    hexadecimal(&all.finalize())
}

/// SHA-256 of settings and of the views that a method sees, pictures and depth to the last bit.
pub(crate) fn of_views(settings: &str, views: &[View]) -> String {
    let mut hash = Sha256::new_with_prefix(settings);
    for view in views {
        add_camera(&mut hash, view);
        let depth = view.depth().map_or(&[][..], DepthMap::data);
        for values in [view.image().data(), depth] {
            hash.update((values.len() as u64).to_le_bytes());
            values.iter().for_each(|value| hash.update(value.to_le_bytes()));
        }
    }
    hexadecimal(&hash.finalize())
}

fn add_camera(hash: &mut Sha256, view: &View) {
    let (camera, lens) = (view.camera(), view.camera().intrinsics());
    hash.update((lens.width as u64).to_le_bytes());
    hash.update((lens.height as u64).to_le_bytes());
    let numbers = [lens.fx, lens.fy, lens.cx, lens.cy];
    let pose = camera.rotation().to_cols_array().into_iter().chain(camera.translation().to_array());
    for number in numbers.into_iter().chain(pose) {
        // Layouts round differently in the last digits, and have zeros of either sign; that does not make other data.
        hash.update(((number * 1e6).round() as i64).to_le_bytes());
    }
}

/// Bytes in hexadecimal digits.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
