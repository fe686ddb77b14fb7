//! Pairs of Gaussian and tile.

use super::{Chain, UNTOUCHED, exact, groups, of, one, words};
use crate::check::Row;
use gs_raster::gpu::Gpu;
use gs_shaders::BIN;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let (given, expected) = (&input.lists, &truth.lists);
    let grid = groups(input.n_gaussians() as usize + 1);
    let nothing = vec![UNTOUCHED; given.pairs.tiles.len()];
    let mut run = |entry_point: &str, offsets: &[u32]| {
        let buffers = [
            one(&input.view.frame),
            of(&given.footprints.splats),
            of(&given.order),
            of(&given.counters),
            of(offsets),
            of(&nothing),
            of(&nothing),
            of(&nothing),
        ];
        gpu.run_pass(&BIN, entry_point, input.view.features, grid, &buffers).expect("the pass runs")
    };
    let counted = run("bin_count", &vec![UNTOUCHED; given.counts.len()]);
    let emitted = run("bin_emit", &given.offsets);
    [
        exact("offsets after bin_count", &expected.counts, &words(&counted[4])),
        exact("offsets after bin_emit", &expected.offsets, &words(&emitted[4])),
        exact("pair_tiles", &expected.pairs.tiles, &words(&emitted[5])),
        exact("pair_index", &expected.pairs.index, &words(&emitted[6])),
        exact("pair_splats", &expected.pairs.splats, &words(&emitted[7])),
    ]
    .into_iter()
    .flatten()
    .collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    for splat in &mut chain.lists.footprints.splats {
        splat.mean[0] += 5.0;
    }
}
