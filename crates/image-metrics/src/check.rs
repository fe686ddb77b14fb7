//! What every measure demands of its two pictures.

use crate::{Error, Result};
use gs_scene::Image;

/// Equal sizes and finite numbers.
pub(crate) fn comparable(a: &Image, b: &Image) -> Result<()> {
    if (a.width(), a.height()) != (b.width(), b.height()) {
        return Err(Error::SizeMismatch {
            expected_width: a.width(),
            expected_height: a.height(),
            found_width: b.width(),
            found_height: b.height(),
        });
    }
    for (picture, image) in [("first", a), ("second", b)] {
        if let Some(at) = image.data().iter().position(|value| !value.is_finite()) {
            let pixel = at / 3;
            return Err(Error::NotFinite { picture, x: pixel % image.width(), y: pixel / image.width() });
        }
    }
    Ok(())
}
