//! Dispatch of the pass `bin`: pairs of Gaussian and tile.

use super::NO_FEATURES;
use crate::gpu::context::{Gpu, Recording, folded};
use crate::gpu::forward::Buffers;
use gs_shaders::{BIN, N_PAIRS, WORKGROUP};

impl Gpu {
    /// Lists the tiles that each Gaussian touches, near to far, and counts all pairs.
    pub(in crate::gpu) fn bin(&mut self, recording: &mut Recording, view: &Buffers) {
        let buffers = [
            Some(&view.uniform),
            Some(&view.splats),
            Some(&view.depths.values),
            Some(&view.counters),
            Some(&view.offsets),
            Some(&view.pairs.keys),
            Some(&view.pairs.values),
            Some(&view.pair_splats),
        ];
        // One more than there are Gaussians: the last offset is the number of pairs.
        let n = view.frame.n_gaussians + 1;
        let groups = folded(n.div_ceil(WORKGROUP));
        self.dispatch(recording, &BIN, "bin_count", NO_FEATURES, groups, &buffers);
        self.scan(recording, &view.offsets, n, &view.counters, N_PAIRS);
        self.dispatch(recording, &BIN, "bin_emit", NO_FEATURES, groups, &buffers);
    }
}
