//! Derivatives of compositing.

use super::{Chain, close, of, one, words};
use crate::check::Row;
use gs_raster::gpu::Gpu;
use gs_reference::tolerance::pass_gradient_bound;
use gs_shaders::{PAIR_GRADS, RASTERIZE_BACKWARD};

const COLUMNS: [&str; PAIR_GRADS] =
    ["v", "v e", "v dy", "v e e", "v e dy", "v dy dy", "red", "green", "blue", "depth"];

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (lists, frame) = (&input.lists, &input.view.frame);
    let zeros = vec![0.0f32; input.backward.pair_grads.len()];
    let buffers = [
        one(frame),
        of(&lists.footprints.splats),
        of(&lists.pairs.splats),
        of(&lists.pair_index),
        of(&lists.ranges),
        of(&input.pixels.ends),
        of(&input.backward.pixel_grads),
        of(&zeros),
    ];
    let features = input.view.features;
    let out = gpu
        .run_pass(&RASTERIZE_BACKWARD, "rasterize_backward", features, frame.tiles, &buffers)
        .expect("the pass runs");
    let found: Vec<f32> = words(&out[7]);
    let column = |grads: &[f32], at: usize| -> Vec<f32> {
        grads.iter().skip(at).step_by(PAIR_GRADS).copied().collect()
    };
    let rows = COLUMNS.into_iter().enumerate().map(|(at, output)| {
        close(output, &column(&truth.backward.pair_grads, at), &column(&found, at), &[], pass_gradient_bound)
    });
    rows.flatten().collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    chain.lists.footprints.splats.iter_mut().for_each(|splat| splat.rgb[1] += 1e-3);
}
