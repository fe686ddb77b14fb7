// tile_ranges: where each tile's run begins and ends in the sorted pairs.
// One invocation: one pair. Dispatch: pair_capacity / WORKGROUP, folded.
// Bindings:
//   0 frame       uniform      Frame
//   1 counters    read         [3] N_PAIRS
//   2 pair_tiles  read         [pairs] ascending
//   3 ranges      read_write   [tiles] first pair and the one after the last; zeros before, and where there are none
// Overrides: WORKGROUP
// Twin: crates/gs-reference/src/tile_ranges.rs

override WORKGROUP: u32;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> pair_tiles: array<u32>;
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2u>;

@compute @workgroup_size(WORKGROUP)
fn tile_ranges(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let pair = folded(workgroup, grid) * WORKGROUP + local;
    let n_pairs = min(counters[N_PAIRS], frame.pair_capacity);
    if pair >= n_pairs {
        return;
    }
    let tile = pair_tiles[pair];
    // A tile that does not exist marks a pair that does not.
    if tile >= frame.tiles.x * frame.tiles.y {
        return;
    }
    if pair == 0u || pair_tiles[pair - 1u] != tile {
        ranges[tile].x = pair;
    }
    if pair + 1u == n_pairs || pair_tiles[pair + 1u] != tile {
        ranges[tile].y = pair + 1u;
    }
}
