//! Pictures of images, depths, errors and masks, and their files.

use crate::colour::{DEPTH, ERROR, colour};
use crate::{Error, Result};
use gs_scene::{Image, write_atomically};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use std::path::Path;

/// Error pictures show the mean absolute difference of the three channels times this factor.
pub const ERROR_GAIN: f32 = 2.5;

/// An 8-bit RGB picture, ready for a file or a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture(RgbImage);

/// Inverse depths that depth pictures run between, one scale for all pictures of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthScale {
    /// 1 / depth of the darkest colour.
    far: f32,
    /// 1 / depth of the lightest colour.
    near: f32,
}

impl DepthScale {
    /// The scale that shows 96 % of the given z-depths, with the rest at its ends; 0 is no depth. Depths that are all
    /// alike, or none, have a scale too.
    pub fn of<'a>(depths: impl IntoIterator<Item = &'a [f32]>) -> Self {
        // Every 7th pixel is plenty for two percentiles, and 7 divides few widths.
        let mut inverse: Vec<f32> = depths
            .into_iter()
            .flat_map(|map| map.iter().step_by(7))
            .filter(|depth| depth.is_finite() && **depth > 0.0)
            .map(|depth| 1.0 / depth)
            .collect();
        if inverse.is_empty() {
            return Self { far: 0.0, near: 1.0 };
        }
        inverse.sort_unstable_by(f32::total_cmp);
        let last = inverse.len() - 1;
        let (far, near) = (inverse[last / 50], inverse[last - last / 50]);
        if near > far { Self { far, near } } else { Self { far: far * 0.5, near: far * 1.5 } }
    }

    /// z-depth of the lightest colour, scene units.
    #[must_use]
    pub fn nearest(self) -> f32 {
        1.0 / self.near
    }

    /// z-depth of the darkest colour, scene units.
    #[must_use]
    pub fn farthest(self) -> f32 {
        1.0 / self.far
    }

    /// Position on the ramp, 0 (far) to 1 (near).
    fn position(self, depth: f32) -> f32 {
        (1.0 / depth - self.far) / (self.near - self.far)
    }
}

impl Picture {
    fn from_pixels(width: usize, height: usize, pixels: impl Iterator<Item = [u8; 3]>) -> Self {
        let bytes: Vec<u8> = pixels.flatten().collect();
        let picture = RgbImage::from_raw(width as u32, height as u32, bytes);
        Self(picture.expect("one colour per pixel"))
    }

    /// The image itself, clipped to 0..1.
    #[must_use]
    pub fn of_image(image: &Image) -> Self {
        let bytes = image.to_rgb8();
        Self::from_pixels(image.width(), image.height(), bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]))
    }

    /// z-depths in colour: near is light, far is dark, none is black.
    ///
    /// # Panics
    /// If `depth` is not one number per pixel.
    #[must_use]
    pub fn of_depth(width: usize, height: usize, depth: &[f32], scale: DepthScale) -> Self {
        let paint = |&depth: &f32| if depth > 0.0 { colour(&DEPTH, scale.position(depth)) } else { [0; 3] };
        Self::from_pixels(width, height, depth.iter().map(paint))
    }

    /// Values in 0..1 as grey: confidence, alpha.
    ///
    /// # Panics
    /// If `values` is not one number per pixel.
    #[must_use]
    pub fn of_mask(width: usize, height: usize, values: &[f32]) -> Self {
        let paint = |value: &f32| [(value.clamp(0.0, 1.0) * 255.0).round() as u8; 3];
        Self::from_pixels(width, height, values.iter().map(paint))
    }

    /// How far two images of one size differ: the mean absolute difference of the channels, [`ERROR_GAIN`] times, in
    /// colour.
    ///
    /// # Panics
    /// If the sizes differ.
    #[must_use]
    pub fn of_error(a: &Image, b: &Image) -> Self {
        assert_eq!((a.width(), a.height()), (b.width(), b.height()), "sizes of two images to be compared");
        let difference = |(p, q): (&[f32], &[f32])| {
            let sum: f32 = p.iter().zip(q).map(|(p, q)| (p.clamp(0.0, 1.0) - q.clamp(0.0, 1.0)).abs()).sum();
            colour(&ERROR, ERROR_GAIN * sum / 3.0)
        };
        let pixels = a.data().chunks_exact(3).zip(b.data().chunks_exact(3)).map(difference);
        Self::from_pixels(a.width(), a.height(), pixels)
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.0.dimensions()
    }

    /// The same picture, at most `width` pixels wide.
    #[must_use]
    pub fn at_most(self, width: u32) -> Self {
        let (old_width, old_height) = self.size();
        if old_width <= width {
            return self;
        }
        let height = (u64::from(old_height) * u64::from(width)).div_ceil(u64::from(old_width)) as u32;
        Self(resize(&self.0, width, height, FilterType::Triangle))
    }

    /// JPEG of the given quality (1 to 100): for pages.
    ///
    /// # Errors
    /// If the encoder refuses the size (more than 65 535 pixels a side).
    pub fn to_jpeg(&self, quality: u8) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.encode(JpegEncoder::new_with_quality(&mut bytes, quality))?;
        Ok(bytes)
    }

    /// PNG: for files.
    ///
    /// # Errors
    /// If the encoder refuses the picture.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.encode(PngEncoder::new(&mut bytes))?;
        Ok(bytes)
    }

    fn encode(&self, encoder: impl ImageEncoder) -> Result<()> {
        let (width, height) = self.size();
        encoder
            .write_image(self.0.as_raw(), width, height, ExtendedColorType::Rgb8)
            .map_err(|source| Error::Encode { width, height, source })
    }

    /// Writes a PNG file, all or nothing; makes its folder.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.to_png()?;
        Ok(write_atomically(path, |out| out.write_all(&bytes))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_hold_the_picture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/a.png");
        let bytes: Vec<u8> = (0..5 * 3 * 3).map(|i| i * 5).collect();
        let picture = Picture::of_image(&Image::from_rgb8(5, 3, &bytes).unwrap());
        picture.save(&path).unwrap();
        let read = image::load_from_memory(&std::fs::read(&path).unwrap()).unwrap().to_rgb8();
        assert_eq!(read.as_raw(), &bytes);
        let jpeg = image::load_from_memory(&picture.to_jpeg(90).unwrap()).unwrap();
        assert_eq!((jpeg.width(), jpeg.height()), (5, 3));
    }

    #[test]
    fn near_is_lighter_than_far_and_no_depth_is_black() {
        let depth = [1.0, 2.0, 4.0, 0.0, f32::NAN];
        let picture = Picture::of_depth(5, 1, &depth, DepthScale { far: 0.25, near: 1.0 });
        let light: Vec<u32> = picture.0.pixels().map(|p| p.0.iter().map(|c| u32::from(*c)).sum()).collect();
        assert!(light[0] > light[1] && light[1] > light[2] && light[2] > 0);
        assert_eq!(light[3..], [0, 0]);
    }

    #[test]
    fn a_depth_scale_always_exists() {
        let constant = [2.0f32; 50];
        for map in [&[][..], &[0.0, f32::NAN], &constant, &[1e-30, 1e30]] {
            let scale = DepthScale::of([map]);
            assert!(scale.near > scale.far && scale.far.is_finite(), "{map:?}: {scale:?}");
        }
        let most: Vec<f32> =
            (1..=7000).map(|i| if i < 30 { 1e-6 } else { 1.0 + i as f32 / 7000.0 }).collect();
        let scale = DepthScale::of([&most[..]]);
        assert!(scale.near < 1.1 && scale.far > 0.49, "{scale:?}");
    }

    #[test]
    fn equal_images_have_no_error_and_opposite_ones_the_largest() {
        let black = Image::filled(2, 2, [0.0; 3]).unwrap();
        let white = Image::filled(2, 2, [1.0; 3]).unwrap();
        assert_eq!(Picture::of_error(&black, &black).0.get_pixel(0, 0).0, ERROR[0]);
        assert_eq!(Picture::of_error(&black, &white).0.get_pixel(1, 1).0, ERROR[255]);
    }

    #[test]
    fn a_smaller_picture_keeps_its_shape() {
        let picture = Picture::of_mask(40, 30, &[0.5; 1200]);
        assert_eq!(picture.clone().at_most(20).size(), (20, 15));
        assert_eq!(picture.at_most(100).size(), (40, 30));
    }
}
