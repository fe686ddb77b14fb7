//! Derivatives of the projection.

use super::{Chain, UNTOUCHED, close, groups, of, one, words};
use crate::check::Row;
use gs_raster::gpu::Gpu;
use gs_reference::Variable;
use gs_reference::tolerance::pass_gradient_bound;
use gs_shaders::{POSE_SUMS, PROJECT_BACKWARD};

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (lists, stored) = (&input.lists, &input.backward.stored);
    let zeros = [vec![0.0f32; stored.geometry.len()], vec![0.0; stored.sh.len()]];
    let nothing = vec![UNTOUCHED; stored.pose_sums.len()];
    let buffers = [
        one(&input.view.frame),
        of(&input.view.geometry),
        of(&input.view.sh),
        of(&lists.order),
        of(&lists.offsets),
        of(&input.backward.pair_grads),
        of(&zeros[0]),
        of(&zeros[1]),
        of(&nothing),
    ];
    let (features, grid) = (input.view.features, groups(input.n_gaussians() as usize));
    let out =
        gpu.run_pass(&PROJECT_BACKWARD, "project_backward", features, grid, &buffers).expect("the pass runs");
    let (geometry, sh): (Vec<f32>, Vec<f32>) = (words(&out[6]), words(&out[7]));
    let (expected, poses) = (&truth.backward.stored, words::<f32>(&out[8]));
    let mut rows = Vec::new();
    for variable in [Variable::Means, Variable::Quaternions, Variable::LogScales, Variable::OpacityLogits] {
        let column = |geometry: &[f32]| variable.of_geometry(geometry).expect("a column of the geometry");
        rows.extend(close(
            variable.name(),
            &column(&expected.geometry),
            &column(&geometry),
            &[],
            pass_gradient_bound,
        ));
    }
    rows.extend(close("sh", &expected.sh, &sh, &[], pass_gradient_bound));
    for (output, columns) in [("axes", 0..9), ("translation", 9..12), ("centre", 12..15)] {
        let part = |sums: &[f32]| -> Vec<f32> {
            sums.chunks_exact(POSE_SUMS).flat_map(|group| group[columns.clone()].to_vec()).collect()
        };
        rows.extend(close(output, &part(&expected.pose_sums), &part(&poses), &[], pass_gradient_bound));
    }
    rows
}

pub(super) fn perturb(chain: &mut Chain) {
    let grads = &mut chain.backward.pair_grads;
    grads.iter_mut().for_each(|grad| *grad *= 1.001);
}
