// bin: which Gaussians touch which tiles.
// bin_count  one invocation: the tiles of one Gaussian, in the order of depth. Dispatch: (n_gaussians + 1) / WORKGROUP, folded.
// bin_emit   one invocation: writes them down, the counts scanned in between. Dispatch: the same.
// Bindings:
//   0 frame        uniform      Frame
//   1 splats       read         [n] Splat
//   2 order        read         [n] indices of Gaussians, the visible ones first, near to far
//   3 counters     read         [3] VISIBLE
//   4 offsets      read_write   [n + 1] tiles of each, then the place of its first pair; the last is the number of pairs
//   5 pair_tiles   read_write   [pairs] tile; NO_TILE where a Gaussian has fewer than it announced
//   6 pair_index   read_write   [pairs] own index, to be sorted by tile
//   7 pair_splats  read_write   [pairs] index of the Gaussian
// Overrides: WORKGROUP TILE
// Twin: crates/gs-reference/src/bin.rs

override WORKGROUP: u32;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> counters: array<u32>;
@group(0) @binding(4) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(5) var<storage, read_write> pair_tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> pair_index: array<u32>;
@group(0) @binding(7) var<storage, read_write> pair_splats: array<u32>;

@compute @workgroup_size(WORKGROUP)
fn bin_count(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = folded(workgroup, grid) * WORKGROUP + local;
    if rank > frame.n_gaussians {
        return;
    }
    var count = 0u;
    if rank < counters[VISIBLE] {
        let ellipse = ellipse_of(splats[order[rank]], log2(frame.alpha_min));
        let rows = tile_rows(ellipse, frame);
        for (var row = rows.x; row < rows.y; row++) {
            let columns = tile_columns(ellipse, row, frame);
            count += columns.y - columns.x;
        }
    }
    offsets[rank] = count;
}

@compute @workgroup_size(WORKGROUP)
fn bin_emit(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = folded(workgroup, grid) * WORKGROUP + local;
    if rank >= counters[VISIBLE] {
        return;
    }
    let index = order[rank];
    let ellipse = ellipse_of(splats[index], log2(frame.alpha_min));
    var pair = min(offsets[rank], frame.pair_capacity);
    let end = min(offsets[rank + 1u], frame.pair_capacity);
    let rows = tile_rows(ellipse, frame);
    for (var row = rows.x; row < rows.y; row++) {
        let columns = tile_columns(ellipse, row, frame);
        for (var column = columns.x; column < columns.y && pair < end; column++) {
            write_pair(pair, row * frame.tiles.x + column, index);
            pair++;
        }
    }
    let no_tile = frame.tiles.x * frame.tiles.y;
    for (; pair < end; pair++) {
        write_pair(pair, no_tile, index);
    }
}

fn write_pair(pair: u32, tile: u32, index: u32) {
    pair_tiles[pair] = tile;
    pair_index[pair] = pair;
    pair_splats[pair] = index;
}
