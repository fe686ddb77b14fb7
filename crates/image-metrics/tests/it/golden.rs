//! Reads files of picture pairs with expected figures, and measures the deviation; shared with an example.

use gs_scene::Image;
use image_metrics::{psnr, ssim};
use safetensors::SafeTensors;
use std::path::Path;

/// Largest deviation from scikit-image in f64, decibels for PSNR.
pub(crate) const TOLERANCE: f64 = 1e-6;

/// Name of a pair and how far (PSNR, SSIM) lie from what the file expects.
pub(crate) type Deviation = (String, f64, f64);

/// Measures every pair in a file.
pub(crate) fn deviations(path: &Path) -> Vec<Deviation> {
    let bytes = std::fs::read(path).expect("the file can be read");
    let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let mut names: Vec<_> = file.names().into_iter().filter_map(|name| name.strip_suffix("/a")).collect();
    names.sort_unstable();
    assert!(!names.is_empty(), "{} holds no pairs", path.display());
    names
        .into_iter()
        .map(|name| {
            let a = picture(&file, &format!("{name}/a"));
            let b = picture(&file, &format!("{name}/b"));
            let off = |found: f64, figure: &str| {
                let expected = number(&file, &format!("{name}/{figure}"));
                if found == expected { 0.0 } else { (found - expected).abs() }
            };
            let psnr = off(psnr(&a, &b).expect("comparable"), "psnr_clipped");
            let ssim = off(ssim(&a, &b).expect("comparable"), "ssim_skimage");
            (name.to_owned(), psnr, ssim)
        })
        .collect()
}

/// A tensor [3, height, width] as an interleaved picture.
fn picture(file: &SafeTensors, name: &str) -> Image {
    let tensor = file.tensor(name).expect("the tensor exists");
    let &[3, height, width] = tensor.shape() else { panic!("{name} is not [3, height, width]") };
    let planes: Vec<f32> = tensor
        .data()
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().expect("four bytes")))
        .collect();
    let pixels = height * width;
    let data = (0..pixels * 3).map(|i| planes[i % 3 * pixels + i / 3]).collect();
    Image::new(width, height, data).expect("a picture")
}

fn number(file: &SafeTensors, name: &str) -> f64 {
    let tensor = file.tensor(name).expect("the tensor exists");
    f64::from_le_bytes(tensor.data().try_into().expect("one f64"))
}
