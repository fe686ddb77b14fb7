//! Compositing.

use super::{Chain, UNTOUCHED, close, exact, of, one, words};
use crate::check::Row;
use gs_raster::gpu::{Gpu, PassBuffer};
use gs_reference::Deviation;
use gs_reference::tolerance::PASS_PIXEL;
use gs_shaders::RASTERIZE_FORWARD;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (lists, frame) = (&input.lists, &input.view.frame);
    let no_pixels = vec![UNTOUCHED; input.pixels.pixels.len()];
    let no_ends = vec![UNTOUCHED; input.pixels.ends.len()];
    let mut run = |entry_point: &str, ends: PassBuffer| {
        let buffers = [
            one(frame),
            of(&lists.footprints.splats),
            of(&lists.pairs.splats),
            of(&lists.pair_index),
            of(&lists.ranges),
            of(&no_pixels),
            ends,
        ];
        gpu.run_pass(&RASTERIZE_FORWARD, entry_point, input.view.features, frame.tiles, &buffers)
            .expect("the pass runs")
    };
    let plain = run("rasterize_forward", PassBuffer::Unused);
    let train = run("rasterize_forward_train", of(&no_ends));
    // Both draw the same; of what is drawn, bytes.
    let mut rows: Vec<Row> =
        exact("rasterize_forward_train", &words(&plain[5]), &words(&train[5])).into_iter().collect();

    let masked = &truth.masked;
    let planes = |pixels: &[f32]| -> [Vec<f32>; 4] {
        let (colours, sums) = pixels.split_at(4 * masked.len());
        let (weights, depths) = sums.split_at(sums.len() / 2);
        [
            colours.chunks_exact(4).flat_map(|pixel| pixel[..3].to_vec()).collect(),
            colours.iter().skip(3).step_by(4).copied().collect(),
            weights.to_vec(),
            depths.to_vec(),
        ]
    };
    let (expected, found) = (planes(&truth.pixels.pixels), planes(&words::<f32>(&train[5])));
    // Depths have the scene's units.
    let least = [("image", 1.0), ("transmittance", 1.0), ("weight", 1.0), ("depth", 0.0)];
    for ((output, least), (expected, found)) in least.into_iter().zip(expected.iter().zip(&found)) {
        let bound = |deviation: &Deviation| PASS_PIXEL * deviation.largest.max(least);
        rows.extend(close(output, expected, found, masked, bound));
    }
    let certain = |ends: &[u32]| -> Vec<u32> {
        ends.iter().zip(masked).filter(|(_, masked)| !**masked).map(|(&end, _)| end).collect()
    };
    rows.extend(exact("ends", &certain(&truth.pixels.ends), &certain(&words(&train[6]))));
    rows
}

pub(super) fn perturb(chain: &mut Chain) {
    let nearest = chain.lists.order[0] as usize;
    chain.lists.footprints.splats[nearest].log2_opacity -= 1e-3;
}
