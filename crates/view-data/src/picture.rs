//! Decoding: PNG and JPEG files to pictures.

use crate::files;
use crate::{Error, Frame, ImageSource, Result};
use gs_scene::Image;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// More pixels than any camera takes; 1.6 GB as f32 RGB.
pub(crate) const MAX_PIXELS: usize = 1 << 27;

/// Enough of a picture to know its size, bytes, unless metadata comes first. A decoder would read it to its end.
const HEADER: u64 = 1 << 14;

impl Frame {
    /// Width and height of [`Frame::picture`], pixels, from the file's header.
    ///
    /// # Errors
    /// If the file is missing, or its header is no picture's.
    pub fn picture_size(&self) -> Result<(usize, usize)> {
        let (width, height) = size(&self.image, &self.name)?;
        let turn = self.turn((width, height), || read_bytes(&self.image, &self.name, u64::MAX))?;
        Ok(if swaps_sides(turn) { (height, width) } else { (width, height) })
    }

    /// The picture as its file has it, encoded.
    ///
    /// # Errors
    /// If the file is missing or cannot be read.
    pub fn picture_bytes(&self) -> Result<Vec<u8>> {
        read_bytes(&self.image, &self.name, u64::MAX)
    }

    /// The picture as its file has it, decoded: in its own size, lens distortion included.
    ///
    /// Poses belong to the pixels as the file holds them, whatever its EXIF data say. Only where the data set states a size that the picture
    /// has after a quarter turn, and EXIF asks for that turn, is it made.
    ///
    /// # Errors
    /// If the file is missing, truncated or damaged.
    pub fn picture(&self) -> Result<Image> {
        let bytes = read_bytes(&self.image, &self.name, u64::MAX)?;
        let mut decoded = decode(&self.image, &bytes)?;
        let size = (decoded.width() as usize, decoded.height() as usize);
        decoded.apply_orientation(self.turn(size, || Ok(bytes))?);
        rgb(decoded).map_err(|source| Error::View { frame: self.name.clone(), source })
    }

    /// The turn that gives a picture of this size the shape that the data set states.
    fn turn(
        &self,
        (width, height): (usize, usize),
        bytes: impl FnOnce() -> Result<Vec<u8>>,
    ) -> Result<Orientation> {
        let fits = |width, height| self.lens.at_size(width, height).is_some();
        if fits(width, height) || !fits(height, width) {
            return Ok(Orientation::NoTransforms);
        }
        let reader = ImageReader::new(Cursor::new(bytes()?)).with_guessed_format();
        let decoder = reader.map_err(ImageError::IoError).and_then(ImageReader::into_decoder);
        let asked = decoder.and_then(|mut decoder| decoder.orientation());
        let asked = asked.map_err(|source| Error::Picture { image: self.image.clone(), source })?;
        Ok(if swaps_sides(asked) { asked } else { Orientation::NoTransforms })
    }
}

/// Whether a turned picture is as wide as it was high.
fn swaps_sides(turn: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(turn, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

/// The picture's width and height, from its header.
pub(crate) fn size(image: &ImageSource, frame: &str) -> Result<(usize, usize)> {
    let dimensions = |bytes: &[u8]| {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
        reader.map_err(ImageError::IoError).and_then(ImageReader::into_dimensions)
    };
    let header = read_bytes(image, frame, HEADER)?;
    let found = match dimensions(&header) {
        Err(_) if header.len() as u64 == HEADER => dimensions(&read_bytes(image, frame, u64::MAX)?),
        found => found,
    };
    let (width, height) = found.map_err(|source| Error::Picture { image: image.clone(), source })?;
    Ok((width as usize, height as usize))
}

/// The encoded bytes of a picture, or the first `most` of them.
pub(crate) fn read_bytes(image: &ImageSource, frame: &str, most: u64) -> Result<Vec<u8>> {
    let path = image.path();
    let read = |source| Error::Read { path: path.to_path_buf(), source };
    let mut file = files::open(path).map_err(|source| unreadable(path, frame, source))?;
    let mut whole = file.metadata().map_err(read)?.len();
    if let ImageSource::Encoded { offset, length, .. } = *image {
        let held = file.metadata().map_err(read)?.len();
        if offset.checked_add(length).is_none_or(|end| end > held) {
            return Err(Error::OutsideFile { path: path.to_path_buf(), offset, length, held });
        }
        file.seek(SeekFrom::Start(offset)).map_err(read)?;
        whole = length;
    }
    files::check_length(whole.min(most)).map_err(read)?;
    let mut bytes = Vec::new();
    file.take(whole.min(most)).read_to_end(&mut bytes).map_err(read)?;
    Ok(bytes)
}

/// An RGB picture in 0..1. Greyscale is spread to three channels, 16 bits are divided by 65535, alpha is blended
/// onto black.
fn rgb(decoded: DynamicImage) -> gs_scene::Result<Image> {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let has_alpha = decoded.color().has_alpha();
    let deep = decoded.color().bytes_per_pixel() / decoded.color().channel_count() > 1;
    if has_alpha {
        let pixels = decoded.into_rgba32f().into_raw();
        let blend = |p: &[f32]| [p[0] * p[3], p[1] * p[3], p[2] * p[3]];
        Image::new(width, height, pixels.chunks_exact(4).flat_map(blend).collect())
    } else if deep {
        Image::new(width, height, decoded.into_rgb32f().into_raw())
    } else {
        Image::from_rgb8(width, height, decoded.into_rgb8().as_raw())
    }
}

/// Decodes a PNG or JPEG file, and returns its bytes as well. Orientation and colour profiles are not applied.
///
/// # Errors
/// If the file cannot be read, is damaged or cut short, or has more pixels than a view may have.
pub fn decode_picture(path: &Path) -> Result<(DynamicImage, Vec<u8>)> {
    let source = ImageSource::File(path.to_path_buf());
    let bytes = read_bytes(&source, "", u64::MAX)?;
    Ok((decode(&source, &bytes)?, bytes))
}

/// Decodes the bytes of a picture.
pub(crate) fn decode(image: &ImageSource, bytes: &[u8]) -> Result<DynamicImage> {
    if bytes.starts_with(&[0xff, 0xd8]) {
        crate::jpeg::check(bytes).map_err(|source| Error::DamagedJpeg { image: image.clone(), source })?;
    }
    let damaged = |source| Error::Picture { image: image.clone(), source };
    let reader = || ImageReader::new(Cursor::new(&bytes)).with_guessed_format();
    let header =
        reader().map_err(ImageError::IoError).and_then(ImageReader::into_dimensions).map_err(damaged)?;
    check_pixels(&image.to_string(), header.0 as usize, header.1 as usize)?;
    reader().map_err(ImageError::IoError).and_then(ImageReader::decode).map_err(damaged)
}

/// At least one pixel, and few enough to hold in memory.
pub(crate) fn check_pixels(what: &str, width: usize, height: usize) -> Result<()> {
    if !(1..=MAX_PIXELS).contains(&width.saturating_mul(height)) {
        return Err(Error::TooLarge { what: what.to_owned(), width, height, max_pixels: MAX_PIXELS });
    }
    Ok(())
}

fn unreadable(path: &Path, frame: &str, source: std::io::Error) -> Error {
    let path = path.to_path_buf();
    if source.kind() == std::io::ErrorKind::NotFound {
        return Error::MissingPicture { path, frame: frame.to_owned() };
    }
    Error::Read { path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_size_is_found_behind_long_metadata_and_at_an_offset() {
        let mut plain = Cursor::new(Vec::new());
        DynamicImage::new_rgb8(31, 17).write_to(&mut plain, image::ImageFormat::Jpeg).unwrap();
        let plain = plain.into_inner();
        // Two application segments of 30 000 bytes behind the start marker push the size beyond what is read first.
        let segment = [&[0xff, 0xe1][..], &30_000u16.to_be_bytes(), &[7; 29_998]].concat();
        let long = [&plain[..2], &segment, &segment, &plain[2..]].concat();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pictures");
        std::fs::write(&path, [&b"before"[..], &long, &plain].concat()).unwrap();
        for (offset, length) in [(6, long.len()), (6 + long.len(), plain.len())] {
            let (offset, length) = (offset as u64, length as u64);
            let image = ImageSource::Encoded { path: path.clone(), offset, length };
            assert_eq!(size(&image, "frame").unwrap(), (31, 17));
            let beyond = ImageSource::Encoded { path: path.clone(), offset: offset + 1, length: u64::MAX };
            assert!(matches!(size(&beyond, "frame"), Err(Error::OutsideFile { .. })));
        }
        let cut = ImageSource::Encoded { path, offset: 6, length: 20_000 };
        assert!(matches!(size(&cut, "frame"), Err(Error::Picture { .. })));
    }
}
