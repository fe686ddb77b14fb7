//! Information richness (paper, section 3.2, eq. "entropy").

#[cfg(target_arch = "x86_64")]
mod avx2;
mod histogram;
#[cfg(target_arch = "x86_64")]
mod sliding;

use crate::importance::check_size;
use crate::{Border, Error, Result, parallel};

/// The window over which entropy is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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

/// Rows per parallel task. The first row of a task costs as much as four others.
const ROWS: usize = 64;

/// Local Shannon entropy in bits, `[height, width]`: -Σ p log2 p over the grey levels in the window around each pixel,
/// within 2^-21 bits of it and the rounding to f32. At most log2 of the number of pixels in the window (5.6 for 7×7),
/// and of `levels`; exactly 0 where the window has one level.
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
    let levels = if levels == 256 {
        grey
    } else {
        coarse = grey.iter().map(|&g| (usize::from(g) * levels / 256) as u8).collect();
        &coarse
    };
    let steps = Steps::new(size);
    let seen = Seen {
        levels,
        size,
        columns: border.sources(width, size),
        rows: border.sources(height, size),
        border,
    };
    #[cfg(target_arch = "x86_64")]
    if width >= sliding::MIN_WIDTH
        && let Some(bits) = sliding::entropy(&seen, &steps)
    {
        return Ok(bits);
    }
    Ok(by_histograms(&seen, &steps))
}

/// A picture and what windows see of it.
struct Seen<'a> {
    /// Grey levels, `[height, width]`.
    levels: &'a [u8],
    size: usize,
    /// The column, if any, that is seen at each place from `size / 2` before the first on, to as far after the last.
    columns: Vec<Option<usize>>,
    /// The same for rows.
    rows: Vec<Option<usize>>,
    border: Border,
}

impl Seen<'_> {
    fn width(&self) -> usize {
        self.columns.len() + 1 - self.size
    }

    /// The rows that the windows of row `y` see.
    fn rows(&self, y: usize) -> impl Iterator<Item = &[u8]> {
        let width = self.width();
        self.rows[y..][..self.size].iter().flatten().map(move |y| &self.levels[y * width..][..width])
    }
}

fn by_histograms(seen: &Seen, steps: &Steps) -> Vec<f32> {
    let width = seen.width();
    let mut out = vec![0f32; seen.levels.len()];
    parallel::for_each_chunk(&mut out, ROWS * width, |task, out| {
        for (i, out) in out.chunks_exact_mut(width).enumerate() {
            histogram::row(seen, task * ROWS + i, 0..width, steps, out);
        }
    });
    out
}

/// Fixed point of `c log2 c`. In integers, adding and taking away leave no drift, the order does not matter, and a
/// window of one level has an entropy of exactly 0. The error of an entropy is at most that of `c log2 c` over c, for
/// the worst c: 2^-21 / 3.
const ONE: f64 = (1u64 << 20) as f64;

/// `c log2 c`, in units of 1 / [`ONE`].
struct Steps {
    /// By the number of pixels c of a level.
    whole: Vec<u64>,
    /// From c to c + 1.
    up: Vec<u32>,
}

impl Steps {
    fn new(size: usize) -> Self {
        let term = |c: usize| (c as f64 * (c as f64).max(1.0).log2() * ONE).round() as u64;
        let whole: Vec<u64> = (0..=size * size).map(term).collect();
        let up = whole.windows(2).map(|pair| (pair[1] - pair[0]) as u32).collect();
        Self { whole, up }
    }

    /// For a window of `n` pixels, (n log2 n, scale): its entropy is (n log2 n - Σ c log2 c) · scale bits.
    fn window(&self, n: usize) -> (u64, f64) {
        (self.whole[n], 1.0 / (n as f64 * ONE))
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

    /// The two ways to entropy give the same bits, on pictures of several strips of rows.
    #[test]
    #[cfg(target_arch = "x86_64")]
    fn sliding_windows_equal_histograms() {
        let mut draws =
            (0..).map(|i: u32| i.wrapping_mul(0x9e37_79b9).rotate_left(11).wrapping_mul(0x85eb_ca6b) >> 24);
        for (width, height) in
            [(1, 1), (2, 3), (6, 70), (7, 7), (31, 70), (32, 70), (33, 65), (64, 3), (91, 130)]
        {
            for modulus in [1, 2, 5, 256] {
                let grey: Vec<u8> =
                    draws.by_ref().take(width * height).map(|g| (g % modulus) as u8).collect();
                for size in [3, 5, 7] {
                    for border in [Border::Reflect, Border::Clip] {
                        let (columns, rows) = (border.sources(width, size), border.sources(height, size));
                        let seen = Seen { levels: &grey, size, columns, rows, border };
                        let steps = Steps::new(size);
                        let expected = by_histograms(&seen, &steps);
                        let chosen =
                            entropy(&grey, width, height, EntropyWindow { size, levels: 256, border });
                        assert!(chosen.unwrap() == expected, "{width}x{height}, {size}, {border:?}");
                        let Some(found) = sliding::entropy(&seen, &steps) else {
                            let none = cpu_isa::Isa::in_use() < cpu_isa::Isa::Avx2
                                || border == Border::Clip && width < size;
                            assert!(none, "{width}x{height}, {size}, {border:?}");
                            continue;
                        };
                        assert!(found == expected, "{width}x{height}, {size}, {border:?}, mod {modulus}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_largest_window_stays_in_range() {
        let window = EntropyWindow { size: 255, ..EntropyWindow::default() };
        let grey: Vec<u8> = (0..=255).collect();
        let bits = entropy(&grey, 16, 16, window).unwrap();
        assert!(bits.iter().all(|&e| (7.9..=8.0).contains(&e)), "{bits:?}");
    }
}
