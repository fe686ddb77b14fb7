//! OpenEXR files: 32-bit floats, without loss.

use crate::Result;
use exr::error::UnitResult;
use exr::prelude::{Encoding, Image as Exr, SpecificChannels, Vec2, WritableImage};
use gs_scene::{DepthMap, Image, write_atomically};
use std::io::{Cursor, Error as IoError};
use std::path::Path;

/// Writes a depth map as one channel `Z`, 32-bit float, scene units, 0 = no depth.
///
/// # Errors
/// If the file cannot be written; what was there before then stays.
pub fn write_exr_depth(path: &Path, depth: &DepthMap) -> Result<()> {
    let (width, height) = (depth.width(), depth.height());
    let sample = |place: Vec2<usize>| (depth.data()[place.y() * width + place.x()],);
    let channels = SpecificChannels::build().with_channel("Z").with_pixel_fn(sample);
    let image = Exr::from_encoded_channels((width, height), Encoding::SMALL_LOSSLESS, channels);
    write(path, |bytes| image.write().to_buffered(bytes))
}

/// Writes linear light as the channels `R`, `G` and `B`, 32-bit float, not clipped: a
/// [`light`](crate::Photograph::light). The picture of a view is sRGB-encoded and belongs into a PNG.
///
/// # Errors
/// As [`write_exr_depth`].
pub fn write_exr_rgb(path: &Path, light: &Image) -> Result<()> {
    let (width, height) = (light.width(), light.height());
    let sample = |place: Vec2<usize>| {
        let [r, g, b] = light.pixel(place.x(), place.y());
        (r, g, b)
    };
    let channels = SpecificChannels::rgb(sample);
    let image = Exr::from_encoded_channels((width, height), Encoding::SMALL_LOSSLESS, channels);
    write(path, |bytes| image.write().to_buffered(bytes))
}

/// The format is written with seeks, which a file that appears all at once does not offer: it is made in memory.
fn write(path: &Path, encode: impl FnOnce(&mut Cursor<Vec<u8>>) -> UnitResult) -> Result<()> {
    Ok(write_atomically(path, |file| {
        let mut bytes = Cursor::new(Vec::new());
        encode(&mut bytes).map_err(IoError::other)?;
        file.write_all(bytes.get_ref())
    })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{ReadChannels, ReadLayers, read};

    fn value(i: usize) -> f32 {
        // Exact, tiny, huge and odd numbers in turn.
        [0.0, 1.0 / 3.0, 1e-30, 3.5e4 + 0.123, 7e30][i % 5] * (1.0 + i as f32)
    }

    #[test]
    fn depth_and_light_come_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let (width, height) = (67, 35);
        let depth = DepthMap::new(width, height, (0..width * height).map(value).collect()).unwrap();
        let path = folder.path().join("new/depth.exr");
        write_exr_depth(&path, &depth).unwrap();
        let file = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = file.all_attributes().from_file(&path).unwrap();
        let channels = &image.layer_data.channel_data.list;
        assert_eq!((channels.len(), channels[0].name.to_string()), (1, "Z".to_owned()));
        let found: Vec<u32> = channels[0].sample_data.values_as_f32().map(f32::to_bits).collect();
        assert!(found.iter().copied().eq(depth.data().iter().map(|d| d.to_bits())));

        let light = Image::new(width, height, (0..3 * width * height).map(value).collect()).unwrap();
        let path = folder.path().join("light.exr");
        write_exr_rgb(&path, &light).unwrap();
        let image = exr::prelude::read_first_rgba_layer_from_file(
            &path,
            |size, _| vec![0.0f32; size.area() * 3],
            |data, place, (r, g, b, _): (f32, f32, f32, f32)| {
                let start = 3 * (place.y() * 67 + place.x());
                data[start..start + 3].copy_from_slice(&[r, g, b]);
            },
        )
        .unwrap();
        assert_eq!(image.layer_data.channel_data.pixels, light.data());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing temporary is left");
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("plain"), b"").unwrap();
        let depth = DepthMap::new(1, 1, vec![1.0]).unwrap();
        let error = write_exr_depth(&folder.path().join("plain/depth.exr"), &depth).unwrap_err();
        assert!(error.to_string().contains("plain"), "{error}");
    }
}
