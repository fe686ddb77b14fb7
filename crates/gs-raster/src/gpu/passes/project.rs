//! Dispatch of the pass `project`: footprints.

use crate::gpu::context::{Gpu, Recording, folded};
use crate::gpu::forward::Buffers;
use crate::gpu::upload::Upload;
use gs_shaders::{PROJECT, WORKGROUP};

impl Gpu {
    /// Gaussians to footprints and depth keys; to those of ellipsoids where the view is `solid`.
    pub(in crate::gpu) fn project(&mut self, recording: &mut Recording, upload: &Upload, view: &Buffers) {
        let entry_point = if view.solid { "project_ellipsoids" } else { "project" };
        let buffers = [
            Some(&view.uniform),
            Some(&upload.geometry),
            Some(&upload.sh),
            Some(&view.splats),
            Some(&view.depths.keys),
            Some(&view.depths.values),
            Some(&view.counters),
            Some(&view.surfaces),
        ];
        let groups = folded(upload.n.div_ceil(WORKGROUP));
        self.dispatch(recording, &PROJECT, entry_point, view.features, groups, &buffers);
    }
}
