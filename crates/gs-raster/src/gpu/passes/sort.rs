//! Dispatches of the pass `sort`: a radix sort, digit by digit.

use super::NO_FEATURES;
use crate::gpu::context::{Gpu, Recording, folded};
use crate::gpu::pool::{Pooled, Use};
use gs_shaders::{ITEMS, NOWHERE, SORT, SORT_DIGIT_BITS, Sort, WORKGROUP};

/// Keys with values.
#[derive(Debug)]
pub(in crate::gpu) struct Keyed {
    pub(in crate::gpu) keys: Pooled,
    pub(in crate::gpu) values: Pooled,
    n: u32,
}

impl Gpu {
    /// Room for `n` keys with values.
    pub(in crate::gpu) fn keyed(&self, n: u32) -> Keyed {
        let room = || self.pool.take(Use::Storage, u64::from(n) * 4);
        Keyed { keys: room(), values: room(), n }
    }

    /// Sorts keys, of which only the low `bits` bits count, with their values; equal keys keep their order. Their number is
    /// in slot `count` of the counters, or it is all that there is room for ([`NOWHERE`]).
    pub(in crate::gpu) fn sort(
        &mut self,
        recording: &mut Recording,
        keyed: &mut Keyed,
        bits: u32,
        counters: &Pooled,
        count: u32,
    ) {
        let n_blocks = keyed.n.div_ceil(WORKGROUP * ITEMS);
        let blocks = folded(n_blocks);
        let digits = 1 << SORT_DIGIT_BITS;
        let histogram = self.pool.take(Use::Storage, u64::from(n_blocks) * u64::from(digits) * 4);
        let mut sorted = self.keyed(keyed.n);
        for shift in (0..bits).step_by(SORT_DIGIT_BITS as usize) {
            let uniform = self.pool.uniform(&Sort { n: keyed.n, n_blocks, count, shift });
            let buffers = [
                Some(&uniform),
                Some(counters),
                Some(&keyed.keys),
                Some(&keyed.values),
                Some(&histogram),
                Some(&sorted.keys),
                Some(&sorted.values),
            ];
            self.dispatch(recording, &SORT, "sort_histogram", NO_FEATURES, blocks, &buffers);
            self.scan(recording, &histogram, n_blocks * digits, counters, NOWHERE);
            self.dispatch(recording, &SORT, "sort_scatter", NO_FEATURES, blocks, &buffers);
            recording.keep.push(uniform);
            std::mem::swap(keyed, &mut sorted);
        }
        recording.keep.extend([histogram, sorted.keys, sorted.values]);
    }
}
