//! Dispatch of the pass `tile_ranges`: where each tile begins.

use super::NO_FEATURES;
use crate::gpu::context::{Gpu, Recording, folded};
use crate::gpu::forward::Buffers;
use gs_shaders::{TILE_RANGES, WORKGROUP};

impl Gpu {
    /// Where each tile's pairs lie among the sorted ones.
    pub(in crate::gpu) fn tile_ranges(&mut self, recording: &mut Recording, view: &Buffers) {
        recording.encoder.clear_buffer(&view.ranges, 0, None);
        let buffers = [Some(&view.uniform), Some(&view.counters), Some(&view.pairs.keys), Some(&view.ranges)];
        let groups = folded(view.frame.pair_capacity.div_ceil(WORKGROUP));
        self.dispatch(recording, &TILE_RANGES, "tile_ranges", NO_FEATURES, groups, &buffers);
    }
}
