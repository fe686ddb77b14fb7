//! What the camera wrote into a file: how it was held, which camera it is, and its focal length.

use exif::{Exif, In, Reader, Tag, Value};
use std::io::Cursor;

/// Of a picture's EXIF data what matters here. Everything is optional, and what cannot be read counts as absent.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct ExifData {
    pub(crate) make: Option<String>,
    pub(crate) model: Option<String>,
    /// Millimetres.
    pub(crate) focal: Option<f64>,
    /// Millimetres on a frame of 36x24 mm.
    pub(crate) focal_35: Option<f64>,
    /// Pixels per millimetre of the sensor, at the size that the camera wrote.
    plane_density: Option<f64>,
    /// Size that the camera wrote, pixels.
    size: Option<[f64; 2]>,
    /// EXIF's number, 1 to 8.
    pub(crate) orientation: u8,
}

/// Diagonal of a frame of 36x24 mm, which "35 mm equivalent" refers to.
const DIAGONAL_35: f64 = 43.266_615_305_567_87;
/// Focal lengths per long side that lenses have; EXIF data outside are wrong.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.2..=15.0;
/// A picture whose aspect ratio differs by more from what the camera wrote was cut, and its focal length in pixels is unknown.
const ASPECT: f64 = 0.02;

impl ExifData {
    /// From the bytes of a file.
    pub(crate) fn read(bytes: &[u8]) -> Self {
        let found = Reader::new().continue_on_error(true).read_from_container(&mut Cursor::new(bytes));
        let exif = match found {
            Ok(exif) => exif,
            Err(error) => match error.distill_partial_result(|_| ()) {
                Ok(exif) => exif,
                Err(_) => return Self { orientation: 1, ..Self::default() },
            },
        };
        let uint = |tag| exif.get_field(tag, In::PRIMARY).and_then(|field| field.value.get_uint(0));
        let above_0 = |value: f64| (value > 0.0 && value.is_finite()).then_some(value);
        let size = uint(Tag::PixelXDimension).zip(uint(Tag::PixelYDimension));
        // Units of the focal plane's resolution: 2 inch, 3 cm, 4 mm; inch without.
        let unit = match uint(Tag::FocalPlaneResolutionUnit) {
            Some(3) => 10.0,
            Some(4) => 1.0,
            _ => 25.4,
        };
        Self {
            make: text(&exif, Tag::Make),
            model: text(&exif, Tag::Model),
            focal: number(&exif, Tag::FocalLength).and_then(above_0),
            focal_35: uint(Tag::FocalLengthIn35mmFilm).and_then(|value| above_0(f64::from(value))),
            plane_density: number(&exif, Tag::FocalPlaneXResolution)
                .and_then(|density| above_0(density / unit)),
            size: size.filter(|&(w, h)| w > 0 && h > 0).map(|(w, h)| [f64::from(w), f64::from(h)]),
            orientation: uint(Tag::Orientation).and_then(|value| u8::try_from(value).ok()).unwrap_or(1),
        }
    }

    /// Focal length in pixels of a picture of this size.
    pub(crate) fn focal_pixels(&self, width: usize, height: usize) -> Option<f64> {
        let (long, short) = (width.max(height) as f64, width.min(height) as f64);
        let written = self.size.map(|[w, h]| (w.max(h), w.min(h)));
        if written.is_some_and(|(l, s)| ((l / s) / (long / short) - 1.0).abs() > ASPECT) {
            return None;
        }
        let by_35 = self.focal_35.map(|focal| focal / DIAGONAL_35 * long.hypot(short));
        let by_plane = || Some(self.focal? * self.plane_density? * long / written?.0);
        by_35.or_else(by_plane).filter(|focal| PLAUSIBLE.contains(&(focal / long)))
    }
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => values.first().map(exif::Rational::to_f64),
        value => value.get_uint(0).map(f64::from),
    }
}

fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(parts) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    let text = String::from_utf8_lossy(parts.first()?).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_focal_length_needs_the_uncut_picture() {
        let exif = ExifData { focal_35: Some(26.0), size: Some([4032.0, 3024.0]), ..ExifData::default() };
        let focal = exif.focal_pixels(4032, 3024).unwrap();
        assert!((focal - 26.0 / DIAGONAL_35 * 5040.0).abs() < 1e-9);
        // Turned and reduced pictures have the same lens.
        assert!((exif.focal_pixels(1512, 2016).unwrap() - focal / 2.0).abs() < 1e-9);
        assert_eq!(exif.focal_pixels(3024, 3024), None);
        let absurd = ExifData { focal_35: Some(3.0), ..exif };
        assert_eq!(absurd.focal_pixels(4032, 3024), None);
    }

    #[test]
    fn the_sensors_density_serves_without_the_equivalent() {
        let exif = ExifData {
            focal: Some(50.0),
            plane_density: Some(151.5),
            size: Some([5616.0, 3744.0]),
            ..ExifData::default()
        };
        assert!((exif.focal_pixels(2808, 1872).unwrap() - 50.0 * 151.5 / 2.0).abs() < 1e-9);
    }

    #[test]
    fn garbage_is_no_data() {
        for bytes in [&b""[..], b"\xff\xd8\xff\xe1\xff\xffExif\0\0", &[0xff; 64]] {
            assert_eq!(ExifData::read(bytes), ExifData { orientation: 1, ..ExifData::default() });
        }
    }
}
