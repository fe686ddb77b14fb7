//! Depth as 32-bit EXR: channel `Z`, scene units, 0 = no measurement.

use super::{WriteRule, broken};
use crate::Result;
use exr::prelude::{Encoding, Image, SpecificChannels, WritableImage};
use gs_scene::DepthMap;
use std::io::Cursor;
use std::path::Path;

pub(super) fn write(depth: &DepthMap, path: &Path) -> Result<()> {
    let (width, height, data) = (depth.width(), depth.height(), depth.data());
    let channels = SpecificChannels::build()
        .with_channel("Z")
        .with_pixel_fn(|position| (data[position.y() * width + position.x()],));
    let image = Image::from_encoded_channels((width, height), Encoding::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    let written = image.write().non_parallel().to_buffered(&mut bytes);
    written.map_err(|source| broken(path, WriteRule::Exr(source)))?;
    super::write_file(path, bytes.get_ref())
}
