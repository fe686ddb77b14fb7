//! The view of ellipsoids.

use super::{Chain, UNTOUCHED, close, of, one, words};
use crate::check::Row;
use gs_raster::gpu::Gpu;
use gs_reference::tolerance::{PASS_ELLIPSOID, PASS_PIXEL};
use gs_shaders::RASTERIZE_ELLIPSOIDS;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (lists, frame) = (&input.ellipsoids.lists, &input.view.frame);
    let no_pixels = vec![UNTOUCHED; input.ellipsoids.pixels.len()];
    let buffers = [
        one(frame),
        of(&lists.footprints.splats),
        of(&lists.pairs.splats),
        of(&lists.pair_index),
        of(&lists.ranges),
        of(&input.ellipsoids.surfaces),
        of(&no_pixels),
    ];
    let features = input.view.features;
    let out = gpu
        .run_pass(&RASTERIZE_ELLIPSOIDS, "rasterize_ellipsoids", features, frame.tiles, &buffers)
        .expect("the pass runs");
    let found: Vec<f32> = words(&out[6]);
    let n_pixels = (frame.size[0] * frame.size[1]) as usize;
    let (image, rest) = found.split_at(4 * n_pixels);
    let (expected_image, expected) = truth.ellipsoids.pixels.split_at(4 * n_pixels);
    let (hits, depths) = rest.split_at(n_pixels);
    let (expected_hits, expected_depths) = expected.split_at(n_pixels);
    let masked = &truth.ellipsoids_masked;
    [
        close("image", expected_image, image, masked, |deviation| PASS_ELLIPSOID * deviation.largest),
        close("hit", expected_hits, hits, masked, |_| 0.0),
        close("depth", expected_depths, depths, masked, |deviation| PASS_PIXEL * deviation.largest),
    ]
    .into_iter()
    .flatten()
    .collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    chain.ellipsoids.surfaces.iter_mut().for_each(|surface| surface.sigma_z *= 1.001);
}
