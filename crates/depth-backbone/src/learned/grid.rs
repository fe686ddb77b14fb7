//! Pictures of channels, with a border of zeros.

use cpu_kernels::{Isa, Rows};

/// `[height + 2, width + 2, channels]`: the outermost pixels are zero, so that a 3×3 window reads no further.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grid {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) channels: usize,
    values: Vec<f32>,
}

impl Grid {
    /// All zeros.
    pub(crate) fn new(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, values: vec![0.0; (width + 2) * (height + 2) * channels] }
    }

    /// Another one of this size, all zeros.
    pub(crate) fn like(&self, channels: usize) -> Self {
        Self::new(self.width, self.height, channels)
    }

    /// Where row `y` begins, without its border.
    fn start(&self, y: usize) -> usize {
        ((y + 1) * (self.width + 2) + 1) * self.channels
    }

    /// Row `y`, `[width, channels]`.
    pub(crate) fn row(&self, y: usize) -> &[f32] {
        &self.values[self.start(y)..][..self.width * self.channels]
    }

    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [f32] {
        let start = self.start(y);
        &mut self.values[start..][..self.width * self.channels]
    }

    /// The channels of a pixel.
    pub(crate) fn pixel(&self, x: usize, y: usize) -> &[f32] {
        &self.row(y)[x * self.channels..][..self.channels]
    }

    pub(crate) fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let channels = self.channels;
        &mut self.row_mut(y)[x * channels..][..channels]
    }

    /// The rows of a product for row `y`: the pixel and, of a window of `side` 3, what is left and right of it, `down` rows below
    /// the top of the window. Neighbours overlap, so nothing is copied.
    pub(crate) fn windows(&self, y: usize, side: usize, down: usize) -> Rows<'_> {
        let width = side * self.channels;
        let start = if side == 1 { self.start(y) } else { (y + down) * (self.width + 2) * self.channels };
        Rows::overlapping(&self.values[start..], self.width, width, self.channels)
    }

    /// max(x, 0) of every value.
    pub(crate) fn relu(&self, isa: Isa) -> Self {
        let mut out = self.clone();
        cpu_kernels::Activation::Relu.apply(isa, &mut out.values);
        out
    }

    /// Adds another one of the same shape.
    pub(crate) fn add(&mut self, other: &Self) {
        for (a, b) in self.values.iter_mut().zip(&other.values) {
            *a += b;
        }
    }

    /// Adds another one where `mask` is above zero.
    pub(crate) fn add_where_positive(&mut self, other: &Self, mask: &Self) {
        for ((a, b), x) in self.values.iter_mut().zip(&other.values).zip(&mask.values) {
            if *x > 0.0 {
                *a += b;
            }
        }
    }

    /// Means of blocks of 2×2 pixels; what is left over on the right and below forms smaller blocks.
    pub(crate) fn halved(&self) -> Self {
        let mut out = Self::new(self.width.div_ceil(2), self.height.div_ceil(2), self.channels);
        self.for_blocks(|x, y, share| {
            let from = self.pixel(x, y);
            for (out, from) in out.pixel_mut(x / 2, y / 2).iter_mut().zip(from) {
                *out += share * from;
            }
        });
        out
    }

    /// The gradient of a grid that was halved, from that of the outcome.
    pub(crate) fn halved_backward(&self, gradient: &Self) -> Self {
        let mut out = self.like(self.channels);
        self.for_blocks(|x, y, share| {
            let from = gradient.pixel(x / 2, y / 2);
            for (out, from) in out.pixel_mut(x, y).iter_mut().zip(from) {
                *out = share * from;
            }
        });
        out
    }

    /// Calls with every pixel, and one over the number of pixels in its block of 2×2.
    fn for_blocks(&self, mut each: impl FnMut(usize, usize, f32)) {
        for y in 0..self.height {
            let rows = 2.min(self.height - y / 2 * 2);
            for x in 0..self.width {
                let columns = 2.min(self.width - x / 2 * 2);
                each(x, y, 1.0 / (rows * columns) as f32);
            }
        }
    }

    /// Adds `half`, each of its pixels repeated in a block of 2×2.
    pub(crate) fn add_doubled(&mut self, half: &Self) {
        for y in 0..self.height {
            for x in 0..self.width {
                for (out, from) in self.pixel_mut(x, y).iter_mut().zip(half.pixel(x / 2, y / 2)) {
                    *out += from;
                }
            }
        }
    }

    /// The gradient of a grid that was doubled, from this of the outcome.
    pub(crate) fn doubled_backward(&self) -> Self {
        let mut out = Self::new(self.width.div_ceil(2), self.height.div_ceil(2), self.channels);
        for y in 0..self.height {
            for x in 0..self.width {
                for (out, from) in out.pixel_mut(x / 2, y / 2).iter_mut().zip(self.pixel(x, y)) {
                    *out += from;
                }
            }
        }
        out
    }
}
