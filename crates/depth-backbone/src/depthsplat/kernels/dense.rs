//! The linear layer on slices: y = x Wᵀ, row by row.

use super::finish::Finish;
use cpu_kernels::{Packed, Rows, multiply};
use rayon::prelude::*;

/// Rows per task.
const BLOCK: usize = 96;

/// Rows whose values lie one input after the other, as after a concatenation along the channels: each input is
/// `[rows, channels]`.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Joined<'a> {
    pub(in crate::depthsplat) inputs: &'a [(&'a [f32], usize)],
}

impl<'a> Joined<'a> {
    fn rows(&self) -> usize {
        self.inputs.first().map_or(0, |(values, channels)| values.len() / channels)
    }

    /// `count` rows from `first` on, in place where there is one input, else copied into `scratch`.
    fn block<'s>(&self, first: usize, count: usize, scratch: &'s mut Vec<f32>) -> Rows<'s>
    where
        'a: 's,
    {
        if let [(values, channels)] = *self.inputs {
            return Rows::new(&values[first * channels..][..count * channels], count, channels);
        }
        let width = self.inputs.iter().map(|(_, channels)| channels).sum();
        scratch.clear();
        for row in first..first + count {
            for (values, channels) in self.inputs {
                scratch.extend_from_slice(&values[row * channels..][..*channels]);
            }
        }
        Rows::new(scratch, count, width)
    }
}

/// y = finish(x W) for every row of x; `[rows, weight.columns()]`.
pub(in crate::depthsplat) fn dense(x: Joined<'_>, weight: &Packed, finish: &Finish<'_>) -> Vec<f32> {
    let (rows, columns) = (x.rows(), weight.columns());
    let mut y = vec![0.0; rows * columns];
    y.par_chunks_mut(BLOCK * columns).enumerate().for_each_init(Vec::new, |scratch, (b, y)| {
        let block = x.block(b * BLOCK, y.len() / columns, scratch);
        multiply(block, weight, y, columns, false);
        finish.apply(y, columns, b * BLOCK * columns);
    });
    y
}
