//! Dispatch of the pass `rasterize_ellipsoids`: solid bodies.

use super::NO_FEATURES;
use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use gs_shaders::RASTERIZE_ELLIPSOIDS;

impl Gpu {
    /// Draws the nearest ellipsoid in each pixel.
    pub(in crate::gpu) fn rasterize_ellipsoids(&mut self, recording: &mut Recording, view: &Buffers) {
        let buffers = [
            Some(&view.uniform),
            Some(&view.splats),
            Some(&view.pair_splats),
            Some(&view.pairs.values),
            Some(&view.ranges),
            Some(&view.surfaces),
            Some(&view.pixels),
        ];
        let (pass, tiles) = (&RASTERIZE_ELLIPSOIDS, view.frame.tiles);
        self.dispatch(recording, pass, "rasterize_ellipsoids", NO_FEATURES, tiles, &buffers);
    }
}
