// rasterize_forward: near-to-far compositing. rasterize_forward_train also says where each pixel ended.
// One workgroup: one tile, one invocation ROWS pixels, one below the other. Dispatch: tiles.x × tiles.y.
// Bindings:
//   0 frame        uniform      Frame
//   1 splats       read         [n] Splat
//   2 pair_splats  read         [pairs] index of the Gaussian
//   3 pair_index   read         [pairs] sorted by tile, within a tile near to far
//   4 ranges       read         [tiles] first pair and the one after the last
//   5 pixels       read_write   [h, w, 4] colour over the background and transmittance; with DEPTH
//                              [h, w] Σ w and [h, w] Σ w z after that
//   6 ends         read_write   [h, w] place in the sorted pairs after the last one that was composited
// Overrides: TILE DEPTH
// Twin: crates/gs-reference/src/rasterize_forward.rs

override DEPTH: bool;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> pair_index: array<u32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> pixels: array<f32>;
@group(0) @binding(6) var<storage, read_write> ends: array<u32>;

// Pixels of an invocation: it reads a Gaussian once for all of them.
const ROWS: u32 = 4u;
// Gaussians of the tile that are in workgroup memory at a time. WebGPU clears that memory before every workgroup, so a batch as
// large as a tile costs more than the barriers that it saves.
const BATCH: u32 = 32u;

var<workgroup> batch: array<Local, BATCH>;
var<workgroup> tile_range: vec2u;
var<workgroup> n_done: atomic<u32>;
var<workgroup> all_done: bool;

struct Pixel {
    colour: vec3f,
    transmittance: f32,
    sum_weight: f32,
    sum_depth: f32,
    // Place after the last Gaussian that was composited, 0 for none.
    end: u32,
    done: bool,
}

@compute @workgroup_size(TILE, TILE / ROWS)
fn rasterize_forward(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    _ = composite(workgroup.xy, place.xy, local);
}

@compute @workgroup_size(TILE, TILE / ROWS)
fn rasterize_forward_train(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let found = composite(workgroup.xy, place.xy, local);
    for (var row = 0u; row < ROWS; row++) {
        let pixel = workgroup.xy * TILE + vec2u(place.x, place.y * ROWS + row);
        if all(pixel < frame.size) {
            ends[pixel.y * frame.size.x + pixel.x] = found[row];
        }
    }
}

// Composites the pixels of this invocation, and returns where each of them ended.
fn composite(tile: vec2u, place: vec2u, local: u32) -> vec4u {
    if local == 0u {
        tile_range = ranges[tile.y * frame.tiles.x + tile.x];
    }
    let range = workgroupUniformLoad(&tile_range);
    let origin = tile * TILE;
    let first = vec2u(place.x, place.y * ROWS);
    let log2_alpha_min = log2(frame.alpha_min);

    var p0 = pixel_at(origin + first);
    var p1 = pixel_at(origin + first + vec2u(0u, 1u));
    var p2 = pixel_at(origin + first + vec2u(0u, 2u));
    var p3 = pixel_at(origin + first + vec2u(0u, 3u));
    for (var start = range.x; start < range.y; start += BATCH) {
        workgroupBarrier();
        if local == 0u {
            all_done = atomicLoad(&n_done) == TILE * TILE;
        }
        if workgroupUniformLoad(&all_done) {
            break;
        }
        let size = min(range.y - start, BATCH);
        for (var i = local; i < size; i += TILE * TILE / ROWS) {
            batch[i] = local_to(splats[pair_splats[pair_index[start + i]]], vec2f(origin));
        }
        workgroupBarrier();
        for (var i = 0u; i < size && !(p0.done && p1.done && p2.done && p3.done); i++) {
            let splat = batch[i];
            let end = start + i + 1u;
            let centre = vec2f(first) + vec2f(0.5);
            meet(&p0, splat, centre, end, log2_alpha_min);
            meet(&p1, splat, centre + vec2f(0.0, 1.0), end, log2_alpha_min);
            meet(&p2, splat, centre + vec2f(0.0, 2.0), end, log2_alpha_min);
            meet(&p3, splat, centre + vec2f(0.0, 3.0), end, log2_alpha_min);
        }
    }
    write(p0, origin + first);
    write(p1, origin + first + vec2u(0u, 1u));
    write(p2, origin + first + vec2u(0u, 2u));
    write(p3, origin + first + vec2u(0u, 3u));
    return vec4u(p0.end, p1.end, p2.end, p3.end);
}

// A pixel before the first Gaussian; one outside the picture is done.
fn pixel_at(pixel: vec2u) -> Pixel {
    let done = !all(pixel < frame.size);
    if done {
        atomicAdd(&n_done, 1u);
    }
    return Pixel(vec3f(0.0), 1.0, 0.0, 0.0, 0u, done);
}

// The pixel whose centre is at `centre` from the tile's top-left corner meets the Gaussian before place `end`.
fn meet(pixel: ptr<function, Pixel>, splat: Local, centre: vec2f, end: u32, log2_alpha_min: f32) {
    let alpha = alpha_at(splat.shape, centre, log2_alpha_min);
    if alpha.drawn && !(*pixel).done {
        let next = (*pixel).transmittance * (1.0 - alpha.value);
        if next < frame.transmittance_min {
            (*pixel).done = true;
            atomicAdd(&n_done, 1u);
        } else {
            let weight = (*pixel).transmittance * alpha.value;
            (*pixel).colour += weight * splat.rgb;
            if DEPTH {
                (*pixel).sum_weight += weight;
                (*pixel).sum_depth += weight * splat.depth;
            }
            (*pixel).transmittance = next;
            (*pixel).end = end;
        }
    }
}

fn write(pixel: Pixel, place: vec2u) {
    if !all(place < frame.size) {
        return;
    }
    let at = place.y * frame.size.x + place.x;
    let colour = pixel.colour + pixel.transmittance * frame.background;
    pixels[at * 4u] = colour.r;
    pixels[at * 4u + 1u] = colour.g;
    pixels[at * 4u + 2u] = colour.b;
    pixels[at * 4u + 3u] = pixel.transmittance;
    if DEPTH {
        let n_pixels = frame.size.x * frame.size.y;
        pixels[n_pixels * 4u + at] = pixel.sum_weight;
        pixels[n_pixels * 5u + at] = pixel.sum_depth;
    }
}
