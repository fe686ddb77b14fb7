//! Dispatch of the pass `project_backward`: gradients by what is stored.

use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use crate::gpu::pool::Pooled;
use crate::gpu::upload::Upload;
use gs_shaders::{PROJECT_BACKWARD, WORKGROUP, folded};

/// Sums over views of the gradients by what is stored.
#[derive(Debug)]
pub(in crate::gpu) struct StoredSums {
    pub(in crate::gpu) geometry: Pooled,
    pub(in crate::gpu) sh: Pooled,
}

impl Gpu {
    /// Adds the gradients by what is stored of the Gaussians; those by the pose go to `pose_sums`, one row per workgroup.
    pub(in crate::gpu) fn project_backward(
        &mut self,
        recording: &mut Recording,
        upload: &Upload,
        view: &Buffers,
        pair_grads: &Pooled,
        sums: &StoredSums,
        pose_sums: &Pooled,
    ) {
        recording.encoder().clear_buffer(pose_sums, 0, None);
        let buffers = [
            view.get("frame"),
            &upload.geometry,
            &upload.sh,
            view.get("order"),
            view.get("offsets"),
            pair_grads,
            &sums.geometry,
            &sums.sh,
            pose_sums,
        ]
        .map(|buffer| Some(buffer.whole()));
        let groups = folded(upload.n.div_ceil(WORKGROUP));
        self.dispatch(recording, &PROJECT_BACKWARD, "project_backward", view.features, groups, &buffers);
    }
}
