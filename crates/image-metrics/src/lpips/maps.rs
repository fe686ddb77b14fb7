//! Feature maps on slices, channels last.

use cpu_kernels::Rows;

/// `[height, width, channels]`.
#[derive(Debug, Clone)]
pub(super) struct Maps {
    pub(super) values: Vec<f32>,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
}

impl Maps {
    pub(super) fn zeros(height: usize, width: usize, channels: usize) -> Self {
        Self { values: vec![0.0; height * width * channels], height, width, channels }
    }

    /// Maps of the same size without values.
    pub(super) fn like(&self) -> Self {
        Self { values: Vec::new(), ..*self }
    }

    pub(super) fn add(&mut self, other: &[f32]) {
        assert_eq!(self.values.len(), other.len(), "maps of one size");
        self.values.iter_mut().zip(other).for_each(|(value, other)| *value += other);
    }

    /// The gradient before a ReLU from that after it: nothing where it gave zero.
    pub(super) fn mask(&mut self, relu: &Self) {
        assert_eq!(self.values.len(), relu.values.len(), "maps of one size");
        for (value, &relu) in self.values.iter_mut().zip(&relu.values) {
            *value = if relu > 0.0 { *value } else { 0.0 };
        }
    }

    pub(super) fn view(&self) -> View<'_> {
        self.part(0, self.channels)
    }

    /// Channels `first..first + channels`.
    pub(super) fn part(&self, first: usize, channels: usize) -> View<'_> {
        View {
            values: &self.values,
            height: self.height,
            width: self.width,
            channels,
            first,
            stride: self.channels,
        }
    }
}

/// Some channels of maps.
#[derive(Debug, Clone, Copy)]
pub(super) struct View<'a> {
    values: &'a [f32],
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
    first: usize,
    stride: usize,
}

impl<'a> View<'a> {
    /// The channels of a pixel.
    pub(super) fn pixel(&self, x: usize, y: usize) -> &'a [f32] {
        &self.values[(y * self.width + x) * self.stride + self.first..][..self.channels]
    }

    /// The channels of pixel (x, y) and of those to its right, as many as fit into `out`.
    pub(super) fn copy(&self, x: usize, y: usize, out: &mut [f32]) {
        if self.channels == self.stride {
            out.copy_from_slice(&self.values[(y * self.width + x) * self.stride..][..out.len()]);
        } else {
            let pixels = out.chunks_exact_mut(self.channels).enumerate();
            pixels.for_each(|(i, out)| out.copy_from_slice(self.pixel(x + i, y)));
        }
    }

    /// A row for every pixel.
    pub(super) fn rows(&self) -> Rows<'a> {
        Rows::strided(&self.values[self.first..], self.height * self.width, self.channels, self.stride)
    }
}
