//! Decoding files of measured depth.

use crate::{Error, ImageSource, Result, exr_depth, picture};
use exr::meta::MetaData;
use image::DynamicImage;
use std::path::Path;

/// What a depth file holds: `[height, width]` counts; none is a measurement that is not finite and above 0.
pub(crate) struct Counts {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) values: Vec<f32>,
}

/// First bytes of an EXR file.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Reads a depth file, PNG or EXR by its first bytes.
pub(crate) fn read_depth(path: &Path, frame: &str) -> Result<Counts> {
    let source = ImageSource::File(path.to_path_buf());
    let bytes = picture::read_bytes(&source, frame, u64::MAX)?;
    if bytes.starts_with(&EXR) {
        return exr_depth::read(&bytes, path);
    }
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
        let found = "a file that does not begin as EXR files do".to_owned();
        return Err(Error::DepthFormat { path: path.to_path_buf(), found });
    }
    match picture::decode(&source, &bytes)? {
        DynamicImage::ImageLuma16(depth) => {
            let (width, height) = (depth.width() as usize, depth.height() as usize);
            Ok(Counts { width, height, values: depth.into_raw().into_iter().map(f32::from).collect() })
        }
        other => {
            let path = path.to_path_buf();
            Err(Error::DepthFormat { path, found: format!("a picture of type {:?}", other.color()) })
        }
    }
}

/// Width and height of a picture or depth file, from its header.
pub(crate) fn size(path: &Path) -> Result<(usize, usize)> {
    let source = ImageSource::File(path.to_path_buf());
    let name = || path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut first = [0; 4];
    let file = crate::files::open(path).and_then(|mut file| std::io::Read::read_exact(&mut file, &mut first));
    if file.is_ok() && first == EXR {
        let meta = MetaData::read_from_file(path, false);
        let meta = meta.map_err(|source| Error::Exr { path: path.to_path_buf(), source })?;
        if let Some(header) = meta.headers.first() {
            return Ok((header.layer_size.0, header.layer_size.1));
        }
    }
    picture::size(&source, &name())
}
