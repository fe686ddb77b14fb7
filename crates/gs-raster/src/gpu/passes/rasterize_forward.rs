//! Dispatch of the pass `rasterize_forward`: the picture.

use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use gs_shaders::RASTERIZE_FORWARD;

impl Gpu {
    /// Blends each tile; with `train` the places where pixels end are kept.
    pub(in crate::gpu) fn rasterize_forward(
        &mut self,
        recording: &mut Recording,
        view: &Buffers,
        train: bool,
    ) {
        let entry_point = if train { "rasterize_forward_train" } else { "rasterize_forward" };
        let buffers = [
            Some(&view.uniform),
            Some(&view.splats),
            Some(&view.pair_splats),
            Some(&view.pairs.values),
            Some(&view.ranges),
            Some(&view.pixels),
            Some(&view.ends),
        ];
        self.dispatch(recording, &RASTERIZE_FORWARD, entry_point, view.features, view.frame.tiles, &buffers);
    }
}
