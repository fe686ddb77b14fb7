//! Dispatches of the pass `scan`: prefix sums.

use super::NO_FEATURES;
use crate::gpu::context::{Gpu, Recording, folded};
use crate::gpu::pool::{Pooled, Use};
use gs_shaders::{ITEMS, SCAN, Scan, WORKGROUP};

impl Gpu {
    /// Replaces the first `n` of `values` by what precedes each; the total goes to a slot of the counters, or nowhere
    /// ([`NOWHERE`](gs_shaders::NOWHERE)).
    pub(in crate::gpu) fn scan(
        &mut self,
        recording: &mut Recording,
        values: &Pooled,
        n: u32,
        counters: &Pooled,
        total: u32,
    ) {
        let n_blocks = n.div_ceil(WORKGROUP * ITEMS);
        let uniform = self.pool.uniform(&Scan { n, n_blocks, total, padding: 0 });
        let sums = self.pool.take(Use::Storage, u64::from(n_blocks) * 4);
        let buffers = [Some(&uniform), Some(values), Some(&sums), Some(counters)];
        let blocks = folded(n_blocks);
        self.dispatch(recording, &SCAN, "scan_reduce", NO_FEATURES, blocks, &buffers);
        self.dispatch(recording, &SCAN, "scan_sums", NO_FEATURES, [1, 1], &buffers);
        self.dispatch(recording, &SCAN, "scan_apply", NO_FEATURES, blocks, &buffers);
        recording.keep.extend([uniform, sums]);
    }
}
