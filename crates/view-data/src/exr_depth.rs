//! Depth in EXR files: one channel of floats, scene units times the file's unit; what is not finite or above 0 is no measurement.

use crate::picture::check_pixels;
use crate::write::{WriteRule, broken, write_file};
use crate::{Error, Result};
use exr::meta::MetaData;
use exr::prelude::{Encoding, FlatSamples, Image, ReadChannels, ReadLayers, SpecificChannels, WritableImage};
use gs_scene::DepthMap;
use std::io::Cursor;
use std::path::Path;

/// Names that depth goes by, the likeliest first. A file with one channel may call it anything.
const NAMES: [&str; 6] = ["Z", "depth", "Depth", "Y", "V", "R"];

/// Width, height and `[height, width]` values of an EXR file.
pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<(usize, usize, Vec<f32>)> {
    let damaged = |source| Error::Exr { path: path.to_path_buf(), source };
    let format = |found: String| Error::DepthFormat { path: path.to_path_buf(), found };
    // The sizes are believed only after they have been looked at.
    let meta = MetaData::read_from_buffered(bytes, false).map_err(damaged)?;
    for header in &meta.headers {
        // All channels are decoded.
        let width = header.layer_size.x().saturating_mul(header.channels.list.len());
        check_pixels(&path.display().to_string(), width, header.layer_size.y())?;
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    let (size, channels) = (image.layer_data.size, &image.layer_data.channel_data.list);
    let named = NAMES.iter().find_map(|name| channels.iter().find(|channel| channel.name.eq(name)));
    let channel = named.or(if channels.len() == 1 { channels.first() } else { None });
    let Some(channel) = channel else {
        let names: Vec<String> = channels.iter().map(|channel| channel.name.to_string()).collect();
        return Err(format(format!("an EXR file with channels {}", names.join(", "))));
    };
    let values = match &channel.sample_data {
        FlatSamples::F32(values) => values.clone(),
        FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
        FlatSamples::U32(_) => return Err(format("an EXR channel of whole numbers".to_owned())),
    };
    if values.len() != size.x() * size.y() {
        return Err(format(format!(
            "an EXR channel of {} values for {}x{}",
            values.len(),
            size.x(),
            size.y()
        )));
    }
    Ok((size.x(), size.y(), values))
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
        let (width, height, values) = read(&encoded(), Path::new("a.exr")).unwrap();
        assert_eq!((width, height), (5, 3));
        assert!(values.iter().enumerate().all(|(i, value)| *value == i as f32 * 0.37));
    }

    #[test]
    fn other_channels_are_named() {
        let channels =
            SpecificChannels::build().with_channel("A").with_channel("B").with_pixel_fn(|_| (1.0f32, 2.0f32));
        let mut bytes = Cursor::new(Vec::new());
        Image::from_channels((4, 4), channels).write().to_buffered(&mut bytes).unwrap();
        let message = read(bytes.get_ref(), Path::new("b.exr")).unwrap_err().to_string();
        assert!(message.contains("b.exr") && message.contains("channels A, B"), "{message}");
    }

    proptest! {
        #[test]
        fn damaged_files_give_errors(flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6), cut in any::<prop::sample::Index>()) {
            let mut bytes = encoded();
            for (at, value) in flips {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            let _ = read(&bytes, Path::new("c.exr"));
            bytes.truncate(cut.index(bytes.len()));
            prop_assert!(read(&bytes, Path::new("c.exr")).is_err());
        }
    }
}
