//! Maximum pooling without padding.

use super::maps::Maps;
use rayon::prelude::*;

/// A square window and its stride.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pool {
    pub(super) side: usize,
    pub(super) stride: usize,
    /// Whether a last window that is cut off by the border counts (PyTorch's `ceil_mode`).
    pub(super) is_partial: bool,
}

impl Pool {
    /// Output size along an axis of `n` pixels.
    pub(super) fn steps(self, n: usize) -> Option<usize> {
        let more = if self.is_partial { self.stride - 1 } else { 0 };
        Some((n + more).checked_sub(self.side)? / self.stride + 1)
    }

    /// The largest of every window, and where it was found: offset from the window's first pixel. The first one counts
    /// where several are equal.
    pub(super) fn apply(self, x: &Maps, height: usize, width: usize) -> (Maps, Vec<u8>) {
        let mut y = Maps::zeros(height, width, x.channels);
        let mut places = vec![0_u8; y.values.len()];
        let row = width * x.channels;
        let rows = y.values.par_chunks_mut(row).zip(places.par_chunks_mut(row)).enumerate();
        rows.for_each(|(row, (y, places))| {
            let pixels = y.chunks_exact_mut(x.channels).zip(places.chunks_exact_mut(x.channels));
            for (column, (y, places)) in pixels.enumerate() {
                let (left, top) = (column * self.stride, row * self.stride);
                y.copy_from_slice(x.view().pixel(left, top));
                for place in 1..self.side * self.side {
                    let (u, v) = (left + place % self.side, top + place / self.side);
                    if u >= x.width || v >= x.height {
                        continue;
                    }
                    for ((y, offset), &value) in y.iter_mut().zip(&mut *places).zip(x.view().pixel(u, v)) {
                        if value > *y {
                            (*y, *offset) = (value, place as u8);
                        }
                    }
                }
            }
        });
        (y, places)
    }

    /// The gradient by the input, of `height` and `width`.
    pub(super) fn pull_back(self, gradient: &Maps, places: &[u8], height: usize, width: usize) -> Maps {
        let channels = gradient.channels;
        let mut out = Maps::zeros(height, width, channels);
        // Windows overlap: they are added in their order.
        for (i, (&value, &place)) in gradient.values.iter().zip(places).enumerate() {
            let (pixel, channel, place) = (i / channels, i % channels, usize::from(place));
            let x = pixel % gradient.width * self.stride + place % self.side;
            let y = pixel / gradient.width * self.stride + place / self.side;
            out.values[(y * width + x) * channels + channel] += value;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_whole_or_cut_and_the_first_of_equals_counts() {
        let x = Maps {
            values: vec![1., 5., 2., 5., 0., 0., 7., 3., 4., 4., 4., 9.],
            height: 3,
            width: 4,
            channels: 1,
        };
        let pool = |is_partial| Pool { side: 3, stride: 2, is_partial };
        assert_eq!(
            (pool(false).steps(4), pool(true).steps(4), pool(true).steps(3)),
            (Some(1), Some(2), Some(1))
        );
        assert_eq!((pool(true).steps(1), pool(false).steps(2), pool(true).steps(2)), (None, None, Some(1)));
        let (y, places) = pool(true).apply(&x, 1, 2);
        assert_eq!((y.values.as_slice(), places.as_slice()), (&[7.0, 9.0][..], &[5, 7][..]));
        let back = pool(true).pull_back(&Maps { values: vec![0.5, -2.0], ..y }, &places, 3, 4);
        assert_eq!(back.values, [0., 0., 0., 0., 0., 0., 0.5, 0., 0., 0., 0., -2.0]);
        let equal = Pool { side: 2, stride: 2, is_partial: false }.apply(&x, 1, 2);
        assert_eq!((equal.0.values.as_slice(), equal.1.as_slice()), (&[5.0, 7.0][..], &[1, 2][..]));
        let halves = Pool { side: 2, stride: 2, is_partial: false };
        assert_eq!(
            halves.apply(&Maps { values: vec![3.0; 4], height: 2, width: 2, channels: 1 }, 1, 1).1,
            [0]
        );
    }
}
