//! Checks of the two pictures, common to all metrics.

use crate::{Error, Result};
use gs_scene::Image;
use rayon::prelude::*;

/// Largest magnitude of a value where f32 computes: powers of it stay far within the range of f32.
pub(crate) const LARGEST: u32 = 1_000_000;

pub(crate) fn same_size(a: &Image, b: &Image) -> Result<()> {
    if (a.width(), a.height()) != (b.width(), b.height()) {
        return Err(Error::SizeMismatch {
            expected_width: a.width(),
            expected_height: a.height(),
            found_width: b.width(),
            found_height: b.height(),
        });
    }
    Ok(())
}

/// `[height, width, 3]` finite numbers, both sides at least `minimum`.
pub(crate) fn finite(
    picture: &'static str,
    values: &[f32],
    width: usize,
    height: usize,
    minimum: usize,
) -> Result<()> {
    within(f32::MAX, picture, values, width, height, minimum)
}

/// As [`finite`], and none beyond ±[`LARGEST`].
pub(crate) fn moderate(
    picture: &'static str,
    values: &[f32],
    width: usize,
    height: usize,
    minimum: usize,
) -> Result<()> {
    within(LARGEST as f32, picture, values, width, height, minimum)
}

fn within(
    limit: f32,
    picture: &'static str,
    values: &[f32],
    width: usize,
    height: usize,
    minimum: usize,
) -> Result<()> {
    let expected = width.saturating_mul(height).saturating_mul(3);
    if values.len() != expected {
        return Err(Error::Length { picture, width, height, expected, found: values.len() });
    }
    if width.min(height) < minimum {
        return Err(Error::TooSmall { width, height, minimum });
    }
    // Whole blocks without a branch, which the compiler makes vectors of; a NaN is not within anything.
    const BLOCK: usize = 1 << 10;
    const PART: usize = 16 * BLOCK;
    let is_within = |value: f32| value.abs() <= limit;
    let block_is_within = |block: &[f32]| block.iter().fold(true, |all, &value| all & is_within(value));
    let part = values.par_chunks(PART).position_first(|part| !part.chunks(BLOCK).all(block_is_within));
    let Some(index) = part.and_then(|part| (part * PART..values.len()).find(|&i| !is_within(values[i])))
    else {
        return Ok(());
    };
    let (x, y) = (index / 3 % width, index / 3 / width);
    Err(if values[index].is_finite() {
        Error::OutOfRange { picture, x, y, limit: LARGEST }
    } else {
        Error::NotFinite { picture, x, y }
    })
}
