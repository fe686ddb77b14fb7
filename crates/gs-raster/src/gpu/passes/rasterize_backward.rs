//! Dispatch of the pass `rasterize_backward`: gradients by footprints.

use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use crate::gpu::pool::Pooled;
use gs_shaders::{Features, RASTERIZE_BACKWARD};

impl Gpu {
    /// Gradients by pixels to sums per pair of Gaussian and tile; those `by_depth` only if there are any.
    pub(in crate::gpu) fn rasterize_backward(
        &mut self,
        recording: &mut Recording,
        view: &Buffers,
        pixel_grads: &Pooled,
        pair_grads: &Pooled,
        by_depth: bool,
    ) {
        recording.encoder().clear_buffer(pair_grads, 0, None);
        let buffers = [
            view.get("frame"),
            view.get("splats"),
            view.get("pair_splats"),
            view.get("pair_index"),
            view.get("ranges"),
            view.get("ends"),
            pixel_grads,
            pair_grads,
        ]
        .map(|buffer| Some(buffer.whole()));
        let (pass, tiles) = (&RASTERIZE_BACKWARD, view.frame.tiles);
        let features = Features { depth: by_depth, ..view.features };
        self.dispatch(recording, pass, "rasterize_backward", features, tiles, &buffers);
    }
}
