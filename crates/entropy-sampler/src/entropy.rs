//! Information richness (paper, section 3.2, eq. "entropy") by running histograms.

use crate::importance::check_size;
use crate::{Border, Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The window over which entropy is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct EntropyWindow {
    /// Width and height, pixels; odd.
    pub size: usize,
    /// Grey levels L, 2 to 256; a grey value g counts as level `g * L / 256`, rounded down.
    pub levels: usize,
    /// What lies beyond the edge.
    pub border: Border,
}

impl EntropyWindow {
    /// Largest window: its counts fit 16 bits.
    pub const MAX_SIZE: usize = 255;
}

impl Default for EntropyWindow {
    /// 7×7 pixels, 256 levels, mirrored border.
    fn default() -> Self {
        Self { size: 7, levels: 256, border: Border::Reflect }
    }
}

/// Rows per parallel task.
const ROWS: usize = 8;

/// Fixed point of `c log2 c`: integers, so that adding and taking away leaves no drift, and a window of one level
/// has an entropy of exactly 0.
const ONE: f64 = (1u64 << 36) as f64;

/// Local Shannon entropy in bits, `[height, width]`: -Σ p log2 p over the grey levels in the window around each pixel.
/// At most log2 of the number of pixels in the window (5.6 for 7×7), and of `levels`.
///
/// # Errors
/// If the size is empty or does not fit `grey`, the window is even or too large, or `levels` is not 2 to 256.
pub fn entropy(grey: &[u8], width: usize, height: usize, window: EntropyWindow) -> Result<Vec<f32>> {
    check_size("grey picture", width, height, grey.len())?;
    let EntropyWindow { size, levels, border } = window;
    if size.is_multiple_of(2) || size > EntropyWindow::MAX_SIZE {
        return Err(Error::WindowSize { found: size });
    }
    if !(2..=256).contains(&levels) {
        return Err(Error::Levels { found: levels });
    }
    let coarse: Vec<u8>;
    let level = if levels == 256 {
        grey
    } else {
        coarse = grey.iter().map(|&g| (usize::from(g) * levels / 256) as u8).collect();
        &coarse
    };
    let table: Vec<u64> =
        (0..=size * size).map(|c| (c as f64 * (c as f64).max(1.0).log2() * ONE).round() as u64).collect();
    let steps: Vec<u64> = table.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let radius = (size / 2) as isize;
    let sources = |n: usize| -> Vec<Option<usize>> {
        (-radius..n as isize + radius).map(|i| border.source(i, n)).collect()
    };
    let (columns, rows) = (sources(width), sources(height));

    let mut out = vec![0f32; grey.len()];
    out.par_chunks_mut(ROWS * width).enumerate().for_each(|(task, out)| {
        let mut seen: Vec<&[u8]> = Vec::with_capacity(size);
        for (i, out) in out.chunks_exact_mut(width).enumerate() {
            seen.clear();
            let around = &rows[task * ROWS + i..][..size];
            seen.extend(around.iter().flatten().map(|y| &level[y * width..][..width]));
            entropy_of_row(&seen, &columns, size, &table, &steps, out);
        }
    });
    Ok(out)
}

/// One row of the result; `seen` are the rows in the window.
fn entropy_of_row(
    seen: &[&[u8]],
    columns: &[Option<usize>],
    size: usize,
    table: &[u64],
    steps: &[u64],
    out: &mut [f32],
) {
    let mut counts = [0u16; 256];
    // Σ c log2 c over the levels, and the number of pixels.
    let (mut sum, mut n) = (0u64, 0);
    for x in 0..out.len() + size - 1 {
        if let Some(column) = columns[x] {
            n += seen.len();
            for row in seen {
                let count = &mut counts[usize::from(row[column])];
                sum += steps[usize::from(*count)];
                *count += 1;
            }
        }
        let Some(pixel) = (x + 1).checked_sub(size) else { continue };
        // -Σ p log2 p = log2 n - Σ c log2 c / n
        out[pixel] = ((table[n] - sum) as f64 / (n as f64 * ONE)) as f32;
        if let Some(column) = columns[pixel] {
            n -= seen.len();
            for row in seen {
                let count = &mut counts[usize::from(row[column])];
                *count -= 1;
                sum -= steps[usize::from(*count)];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_of_one_level_has_no_entropy_and_two_halves_have_one_bit() {
        for border in [Border::Reflect, Border::Clip] {
            let window = EntropyWindow { border, ..EntropyWindow::default() };
            assert_eq!(entropy(&[9; 40], 8, 5, window).unwrap(), [0.0; 40]);
            assert_eq!(entropy(&[9], 1, 1, window).unwrap(), [0.0]);
        }
        let clip = EntropyWindow { border: Border::Clip, ..EntropyWindow::default() };
        assert_eq!(entropy(&[0, 200], 2, 1, clip).unwrap(), [1.0; 2]);
    }

    #[test]
    fn levels_merge_grey_values() {
        let two = EntropyWindow { levels: 2, border: Border::Clip, ..EntropyWindow::default() };
        assert_eq!(entropy(&[0, 127], 2, 1, two).unwrap(), [0.0; 2]);
        assert_eq!(entropy(&[127, 128], 2, 1, two).unwrap(), [1.0; 2]);
    }

    #[test]
    fn bad_settings_name_their_rule() {
        let with = |size, levels| {
            let window = EntropyWindow { size, levels, border: Border::Clip };
            entropy(&[0; 4], 2, 2, window).unwrap_err().to_string()
        };
        assert_eq!(with(4, 256), "entropy window is 4 pixels wide, expected an odd number from 1 to 255");
        assert_eq!(with(0, 256), "entropy window is 0 pixels wide, expected an odd number from 1 to 255");
        assert_eq!(with(257, 256), "entropy window is 257 pixels wide, expected an odd number from 1 to 255");
        assert_eq!(with(7, 1), "1 grey levels, expected 2 to 256");
        assert_eq!(with(7, 257), "257 grey levels, expected 2 to 256");
        let short = entropy(&[0; 3], 2, 2, EntropyWindow::default()).unwrap_err();
        assert_eq!(short.to_string(), "grey picture holds 3 numbers, expected 4");
        let empty = entropy(&[], 0, 2, EntropyWindow::default()).unwrap_err();
        assert_eq!(empty.to_string(), "size is 0x2, expected at least one pixel and at most 2^31");
    }

    #[test]
    fn the_largest_window_stays_in_range() {
        let window = EntropyWindow { size: 255, ..EntropyWindow::default() };
        let grey: Vec<u8> = (0..=255).collect();
        let bits = entropy(&grey, 16, 16, window).unwrap();
        assert!(bits.iter().all(|&e| (7.9..=8.0).contains(&e)), "{bits:?}");
    }
}
