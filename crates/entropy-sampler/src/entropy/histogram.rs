//! Running histograms: any window, any processor. 2·size counts change from pixel to pixel.

use super::{Seen, Steps};
use std::ops::Range;

/// Entropy of the pixels `range` of row `y`.
pub(super) fn row(seen: &Seen, y: usize, range: Range<usize>, steps: &Steps, out: &mut [f32]) {
    let (size, columns) = (seen.size, &seen.columns);
    let rows: Vec<&[u8]> = seen.rows(y).collect();
    let mut counts = [0u16; 256];
    // Σ c log2 c over the levels, and the number of pixels.
    let (mut sum, mut n) = (0u64, 0);
    for x in range.start..range.end + size - 1 {
        if let Some(column) = columns[x] {
            n += rows.len();
            for row in &rows {
                let count = &mut counts[usize::from(row[column])];
                sum += u64::from(steps.up[usize::from(*count)]);
                *count += 1;
            }
        }
        let Some(pixel) = (x + 1).checked_sub(size).filter(|&pixel| pixel >= range.start) else { continue };
        let (whole, scale) = steps.window(n);
        out[pixel] = ((whole - sum) as f64 * scale) as f32;
        if let Some(column) = columns[pixel] {
            n -= rows.len();
            for row in &rows {
                let count = &mut counts[usize::from(row[column])];
                *count -= 1;
                sum -= u64::from(steps.up[usize::from(*count)]);
            }
        }
    }
}
