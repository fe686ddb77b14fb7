// rasterize_forward: near-to-far compositing. rasterize_forward_train also says where each pixel ended.
// One workgroup: one tile, one invocation a pixel. Dispatch: tiles.x × tiles.y.
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

var<workgroup> batch: array<Local, TILE * TILE>;
var<workgroup> tile_range: vec2u;
var<workgroup> n_done: atomic<u32>;
var<workgroup> all_done: bool;

@compute @workgroup_size(TILE, TILE)
fn rasterize_forward(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    _ = composite(workgroup, place, local);
}

@compute @workgroup_size(TILE, TILE)
fn rasterize_forward_train(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let end = composite(workgroup, place, local);
    let pixel = workgroup.xy * TILE + place.xy;
    if all(pixel < frame.size) {
        ends[pixel.y * frame.size.x + pixel.x] = end;
    }
}

// Composites this invocation's pixel, and returns the place after its last Gaussian (0 for none).
fn composite(workgroup: vec3u, place: vec3u, local: u32) -> u32 {
    if local == 0u {
        tile_range = ranges[workgroup.y * frame.tiles.x + workgroup.x];
    }
    let range = workgroupUniformLoad(&tile_range);
    let pixel = workgroup.xy * TILE + place.xy;
    let inside = all(pixel < frame.size);
    let origin = vec2f(workgroup.xy * TILE);
    let centre = vec2f(place.xy) + vec2f(0.5);
    let log2_alpha_min = log2(frame.alpha_min);

    var colour = vec3f(0.0);
    var sum_weight = 0.0;
    var sum_depth = 0.0;
    var transmittance = 1.0;
    var end = 0u;
    var done = !inside;
    if done {
        atomicAdd(&n_done, 1u);
    }
    for (var start = range.x; start < range.y; start += TILE * TILE) {
        workgroupBarrier();
        if local == 0u {
            all_done = atomicLoad(&n_done) == TILE * TILE;
        }
        if workgroupUniformLoad(&all_done) {
            break;
        }
        let size = min(range.y - start, TILE * TILE);
        if local < size {
            batch[local] = local_to(splats[pair_splats[pair_index[start + local]]], origin);
        }
        workgroupBarrier();
        for (var i = 0u; i < size && !done; i++) {
            let splat = batch[i];
            let alpha = alpha_at(splat, centre, log2_alpha_min);
            if alpha.drawn {
                let next = transmittance * (1.0 - alpha.value);
                if next < frame.transmittance_min {
                    done = true;
                    atomicAdd(&n_done, 1u);
                } else {
                    let weight = transmittance * alpha.value;
                    colour += weight * splat.rgb;
                    if DEPTH {
                        sum_weight += weight;
                        sum_depth += weight * splat.depth;
                    }
                    transmittance = next;
                    end = start + i + 1u;
                }
            }
        }
    }
    if inside {
        let at = pixel.y * frame.size.x + pixel.x;
        colour += transmittance * frame.background;
        pixels[at * 4u] = colour.r;
        pixels[at * 4u + 1u] = colour.g;
        pixels[at * 4u + 2u] = colour.b;
        pixels[at * 4u + 3u] = transmittance;
        if DEPTH {
            let n_pixels = frame.size.x * frame.size.y;
            pixels[n_pixels * 4u + at] = sum_weight;
            pixels[n_pixels * 5u + at] = sum_depth;
        }
    }
    return end;
}
