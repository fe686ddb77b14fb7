//! Pictures and 16-bit depth as files.

use super::{WriteRule, broken};
use crate::Result;
use gs_scene::{DepthMap, Image};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageResult};
use std::path::Path;

/// File format of written pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum PictureFormat {
    /// 8 bits per channel, without loss.
    #[default]
    Png,
    /// JPEG of quality 95.
    Jpeg,
}

/// What photographers call visually lossless.
const JPEG_QUALITY: u8 = 95;

impl PictureFormat {
    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
        }
    }
}

/// Writes an 8-bit picture.
pub(super) fn write(image: &Image, path: &Path, format: PictureFormat) -> Result<()> {
    let pixels = image.to_rgb8();
    let size = (image.width(), image.height());
    encode(path, |bytes| match format {
        PictureFormat::Png => write_to(PngEncoder::new(bytes), &pixels, size, ExtendedColorType::Rgb8),
        PictureFormat::Jpeg => write_to(
            JpegEncoder::new_with_quality(bytes, JPEG_QUALITY),
            &pixels,
            size,
            ExtendedColorType::Rgb8,
        ),
    })
}

/// Writes z-depth as counts of `1 / scale`, and returns how many pixels had a depth beyond them. 0 is no measurement.
pub(super) fn write_depth(depth: &DepthMap, path: &Path, scale: f64) -> Result<u64> {
    let mut lost = 0;
    let mut bytes = Vec::with_capacity(depth.data().len() * 2);
    for &z in depth.data() {
        let count = (f64::from(z) * scale).round();
        // Less than half a count is a measurement that would turn into none.
        let fits = z == 0.0 || (1.0..=65535.0).contains(&count);
        lost += u64::from(!fits);
        bytes.extend_from_slice(&(if fits { count as u16 } else { 0 }).to_ne_bytes());
    }
    let size = (depth.width(), depth.height());
    encode(path, |out| write_to(PngEncoder::new(out), &bytes, size, ExtendedColorType::L16))?;
    Ok(lost)
}

fn write_to(
    encoder: impl ImageEncoder,
    pixels: &[u8],
    (width, height): (usize, usize),
    colour: ExtendedColorType,
) -> ImageResult<()> {
    // gs_scene's sizes fit into u32.
    encoder.write_image(pixels, width as u32, height as u32, colour)
}

fn encode(path: &Path, fill: impl FnOnce(&mut Vec<u8>) -> ImageResult<()>) -> Result<()> {
    let mut bytes = Vec::new();
    fill(&mut bytes).map_err(|source| broken(path, WriteRule::Encode(source)))?;
    super::write_file(path, &bytes)
}
