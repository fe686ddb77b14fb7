//! Runs of tiles.

use super::{Chain, exact, groups, of, one, words};
use crate::check::Row;
use gs_raster::gpu::Gpu;
use gs_shaders::TILE_RANGES;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let pass = &input.lists;
    let ranges = vec![[0u32; 2]; pass.ranges.len()];
    let buffers = [one(&input.view.frame), of(&pass.counters), of(&pass.sorted_tiles), of(&ranges)];
    let grid = groups(pass.sorted_tiles.len());
    let out = gpu
        .run_pass(&TILE_RANGES, "tile_ranges", input.view.features, grid, &buffers)
        .expect("the pass runs");
    exact("ranges", truth.lists.ranges.as_flattened(), &words(&out[3])).into_iter().collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    let tiles = &mut chain.lists.sorted_tiles;
    let last = tiles.partition_point(|&tile| tile == tiles[0]) - 1;
    tiles[last] += 1;
}
