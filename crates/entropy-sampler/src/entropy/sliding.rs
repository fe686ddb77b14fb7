//! Strips of rows through the windows of [`avx2`](super::avx2).

use super::avx2::{ByteSteps, LANES, Windows};
use super::{ROWS, Seen, Steps, histogram};
use crate::{Border, parallel};

/// Narrower pictures are left to the histograms: a padded row has at least 64 bytes, which would be up to 64 times what
/// the picture has. From here on it is at most three times that.
pub(super) const MIN_WIDTH: usize = LANES;

/// The entropy map, or none if this processor or the size of the window asks for histograms.
pub(super) fn entropy(seen: &Seen, steps: &Steps) -> Option<Vec<f32>> {
    let (size, width) = (seen.size, seen.width());
    // Of the windows that are cut at the left or right, this many at each side, the histograms take care.
    let cut = if seen.border == Border::Clip { size / 2 } else { 0 };
    if width <= 2 * cut {
        return None;
    }
    let byte_steps = ByteSteps::new(size, steps)?;
    let padded = pad(seen);
    let row_len = Windows::row_len(width, size);
    // By the place in `seen.rows`: the padded row that is seen there.
    let row = |place: usize| seen.rows[place].map(|y| &padded[y * row_len..][..row_len]);

    let mut out = vec![0f32; seen.levels.len()];
    parallel::for_each_chunk(&mut out, ROWS * width, |task, out| {
        let mut windows = Windows::new(width, &byte_steps);
        let mut stay: Vec<&[u8]> = Vec::with_capacity(size);
        for (i, out) in out.chunks_exact_mut(width).enumerate() {
            let y = task * ROWS + i;
            let new = if i == 0 { y..y + size } else { y + size - 1..y + size };
            for joins in new {
                stay.clear();
                stay.extend((y..joins).filter_map(row));
                let leaves = if i == 0 { None } else { row(y - 1) };
                windows.slide(row(joins), leaves, &stay);
            }
            let (whole, scale) = steps.window(size * seen.rows(y).count());
            // 32 bits hold it: 49 log2 49 is 275.
            let whole = whole as i32;
            for (out, &sum) in out.iter_mut().zip(&windows.sums) {
                *out = (f64::from(whole - sum) * scale) as f32;
            }
            if cut > 0 {
                histogram::row(seen, y, 0..cut, steps, out);
                histogram::row(seen, y, width - cut..width, steps, out);
            }
        }
    });
    Some(out)
}

/// All rows of the picture, continued at both sides as far as windows see, and with room for [`Windows::slide`].
fn pad(seen: &Seen) -> Vec<u8> {
    let (size, width) = (seen.size, seen.width());
    let row_len = Windows::row_len(width, size);
    let mut padded = vec![0; seen.levels.len() / width * row_len];
    let first = size - 1;
    for (padded, row) in padded.chunks_exact_mut(row_len).zip(seen.levels.chunks_exact(width)) {
        padded[first + size / 2..][..width].copy_from_slice(row);
        for place in (0..size / 2).chain(width + size / 2..seen.columns.len()) {
            padded[first + place] = seen.columns[place].map_or(0, |column| row[column]);
        }
    }
    padded
}

#[cfg(test)]
mod tests {
    use super::super::avx2::MAX_SIZE;
    use super::*;

    #[test]
    fn padding_is_at_most_twice_the_picture() {
        for width in MIN_WIDTH..1000 {
            assert!(Windows::row_len(width, MAX_SIZE) <= 3 * width, "{width}");
        }
    }
}
