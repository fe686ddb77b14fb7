//! Depth in EXR files: one channel of floats, scene units times the file's unit; what is not finite or above 0 is no measurement.

use crate::depth::Counts;
use crate::picture::check_pixels;
use crate::write::{WriteRule, broken, write_file};
use crate::{Error, Result};
use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::{
    Encoding, Image, ReadChannels, ReadLayers, ReadSpecificChannel, SampleType, SpecificChannels, Vec2,
    WritableImage,
};
use gs_scene::DepthMap;
use std::io::Cursor;
use std::path::Path;

/// Names that depth goes by, the likeliest first. A file with one channel may call it anything.
const NAMES: [&str; 6] = ["Z", "depth", "Depth", "Y", "V", "R"];
/// Pixels per byte of a file at most: more than the densest compression gives for a single value.
const MAX_PIXELS_PER_BYTE: usize = 4096;

/// The depth of an EXR file: of the first layer that has a channel of a known name, or one channel only.
pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<Counts> {
    let damaged = |source| Error::Exr { path: path.to_path_buf(), source };
    let format = |found: String| Error::DepthFormat { path: path.to_path_buf(), found };
    let meta = MetaData::read_from_buffered(bytes, false).map_err(damaged)?;
    let channel_of = |header: &Header| {
        let channels = &header.channels.list;
        let named = NAMES.iter().find_map(|name| channels.iter().find(|channel| channel.name.eq(name)));
        let only = if channels.len() == 1 { channels.first() } else { None };
        named.or(only).map(|channel| (channel.name.to_string(), channel.sample_type))
    };
    let found = meta.headers.iter().find_map(|header| Some((header, channel_of(header)?)));
    let Some((header, (channel, kind))) = found else {
        let names = meta.headers.iter().flat_map(|header| &header.channels.list);
        let names: Vec<String> = names.take(16).map(|channel| channel.name.to_string()).collect();
        return Err(format(format!("an EXR file with channels {}", names.join(", "))));
    };
    if kind == SampleType::U32 {
        return Err(format("an EXR channel of whole numbers".to_owned()));
    }
    // The size is believed only after it has been looked at.
    let Vec2(width, height) = header.layer_size;
    check_pixels(&path.display().to_string(), width, height)?;
    if width * height > bytes.len().saturating_mul(MAX_PIXELS_PER_BYTE) {
        return Err(Error::Unlikely { path: path.to_path_buf(), width, height, bytes: bytes.len() });
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required::<f32>(channel.as_str())
        .collect_pixels(
            |size: Vec2<usize>, _: &_| (size.0, vec![0.0_f32; size.0 * size.1]),
            |(width, values): &mut (usize, Vec<f32>), position: Vec2<usize>, (value,): (f32,)| {
                values[position.1 * *width + position.0] = value;
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    let Vec2(width, height) = image.layer_data.size;
    Ok(Counts { width, height, values: image.layer_data.channel_data.pixels.1 })
}

/// Writes a depth map as 32-bit floats, channel `Z`.
pub(crate) fn write(depth: &DepthMap, path: &Path) -> Result<()> {
    let (width, height, data) = (depth.width(), depth.height(), depth.data());
    let channels = SpecificChannels::build()
        .with_channel("Z")
        .with_pixel_fn(|position| (data[position.y() * width + position.x()],));
    let image = Image::from_encoded_channels((width, height), Encoding::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    let written = image.write().non_parallel().to_buffered(&mut bytes);
    written.map_err(|source| broken(path, WriteRule::Exr(source)))?;
    write_file(path, bytes.get_ref())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encoded() -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let depth = DepthMap::new(5, 3, (0..15).map(|i| i as f32 * 0.37).collect()).unwrap();
        write(&depth, &path).unwrap();
        std::fs::read(&path).unwrap()
    }

    #[test]
    fn what_is_written_is_read_bit_for_bit() {
        let Counts { width, height, values } = read(&encoded(), Path::new("a.exr")).unwrap();
        assert_eq!((width, height), (5, 3));
        assert!(values.iter().enumerate().all(|(i, value)| *value == i as f32 * 0.37));
    }

    #[test]
    fn other_channels_are_named() {
        let channels =
            SpecificChannels::build().with_channel("A").with_channel("B").with_pixel_fn(|_| (1.0f32, 2.0f32));
        let mut bytes = Cursor::new(Vec::new());
        Image::from_channels((4, 4), channels).write().to_buffered(&mut bytes).unwrap();
        let message = read(bytes.get_ref(), Path::new("b.exr")).err().unwrap().to_string();
        assert!(message.contains("b.exr") && message.contains("channels A, B"), "{message}");
    }

    proptest! {
        #[test]
        fn damaged_files_give_errors(flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6), cut in any::<prop::sample::Index>()) {
            let mut bytes = encoded();
            for (place, value) in flips {
                let index = place.index(bytes.len());
                bytes[index] = value;
            }
            let _ = read(&bytes, Path::new("c.exr"));
            bytes.truncate(cut.index(bytes.len()));
            prop_assert!(read(&bytes, Path::new("c.exr")).is_err());
        }
    }
}
