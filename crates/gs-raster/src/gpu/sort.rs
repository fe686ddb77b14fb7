//! Prefix sums and sorting: several dispatches each.

use super::context::{Gpu, Recording, folded};
use super::pool::{Pooled, Use};
use gs_shaders::{Features, ITEMS, NOWHERE, SCAN, SORT, SORT_DIGIT_BITS, Scan, Sort, WORKGROUP};

/// Numbers that one workgroup takes.
const BLOCK: u32 = WORKGROUP * ITEMS;
/// `scan` and `sort` depend on no feature.
pub(super) const NO_FEATURES: Features = Features { sh_degree: 0, antialias: false, depth: false };

/// Keys with values, and room to sort them in.
#[derive(Debug)]
pub(super) struct Keyed {
    pub(super) keys: Pooled,
    pub(super) values: Pooled,
    spare_keys: Pooled,
    spare_values: Pooled,
    n: u32,
}

impl Gpu {
    /// Room for `n` keys with values.
    pub(super) fn keyed(&self, n: u32) -> Keyed {
        let room = || self.pool.take(Use::Storage, u64::from(n) * 4);
        Keyed { keys: room(), values: room(), spare_keys: room(), spare_values: room(), n }
    }

    /// Replaces the first `n` of `values` by what precedes each; the total goes to a slot of the counters, or [`NOWHERE`].
    pub(super) fn scan(
        &mut self,
        recording: &mut Recording,
        values: &Pooled,
        n: u32,
        counters: &Pooled,
        total: u32,
    ) {
        let n_blocks = n.div_ceil(BLOCK);
        let uniform = self.pool.uniform(&Scan { n, n_blocks, total, padding: 0 });
        let sums = self.pool.take(Use::Storage, u64::from(n_blocks) * 4);
        let buffers = [Some(&uniform), Some(values), Some(&sums), Some(counters)];
        let blocks = folded(n_blocks);
        self.dispatch(recording, &SCAN, "scan_reduce", NO_FEATURES, blocks, &buffers);
        self.dispatch(recording, &SCAN, "scan_sums", NO_FEATURES, [1, 1], &buffers);
        self.dispatch(recording, &SCAN, "scan_apply", NO_FEATURES, blocks, &buffers);
        recording.keep.extend([uniform, sums]);
    }

    /// Sorts keys, of which only the low `bits` bits count, with their values; equal keys keep their order. Their number is
    /// in slot `count` of the counters, or it is all that there is room for ([`NOWHERE`]).
    pub(super) fn sort(
        &mut self,
        recording: &mut Recording,
        keyed: &mut Keyed,
        bits: u32,
        counters: &Pooled,
        count: u32,
    ) {
        let n_blocks = keyed.n.div_ceil(BLOCK);
        let digits = 1 << SORT_DIGIT_BITS;
        let histogram = self.pool.take(Use::Storage, u64::from(n_blocks) * digits * 4);
        for shift in (0..bits).step_by(SORT_DIGIT_BITS as usize) {
            let uniform = self.pool.uniform(&Sort { n: keyed.n, n_blocks, count, shift });
            let buffers = [
                Some(&uniform),
                Some(counters),
                Some(&keyed.keys),
                Some(&keyed.values),
                Some(&histogram),
                Some(&keyed.spare_keys),
                Some(&keyed.spare_values),
            ];
            let blocks = folded(n_blocks);
            self.dispatch(recording, &SORT, "sort_histogram", NO_FEATURES, blocks, &buffers);
            self.scan(recording, &histogram, n_blocks * digits as u32, counters, NOWHERE);
            self.dispatch(recording, &SORT, "sort_scatter", NO_FEATURES, blocks, &buffers);
            recording.keep.push(uniform);
            std::mem::swap(&mut keyed.keys, &mut keyed.spare_keys);
            std::mem::swap(&mut keyed.values, &mut keyed.spare_values);
        }
        recording.keep.push(histogram);
    }
}

impl Keyed {
    /// The values, and what is no longer needed.
    pub(super) fn into_values(self) -> (Pooled, [Pooled; 3]) {
        (self.values, [self.keys, self.spare_keys, self.spare_values])
    }
}
