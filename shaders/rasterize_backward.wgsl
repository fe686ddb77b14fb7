// rasterize_backward: derivatives by the footprints, summed over the pixels of a tile in a fixed order.
// One workgroup: one tile. Dispatch: tiles.x × tiles.y.
// Invocation i owns every (TILE * TILE)-th pair and carries its sums; pixels pass from one invocation to the next like work
// pieces on a belt, each meeting the Gaussians far to near. So no sum is shared, and there is nothing to add atomically.
// Bindings:
//   0 frame        uniform      Frame
//   1 splats       read         [n] Splat
//   2 pair_splats  read         [pairs] index of the Gaussian
//   3 pair_index   read         [pairs] sorted by tile, within a tile near to far
//   4 ranges       read         [tiles] first pair and the one after the last
//   5 ends         read         [h, w] place after the last pair that was composited
//   6 pixel_grads  read         [h, w, 6] by colour (3), by transmittance, by Σ w z, then the transmittance itself
//   7 pair_grads   read_write   [pairs, 10] by pair before sorting; zeros before. Sums over pixels, with v the derivative by the
//                               exponent -ln alpha: v, v e, v dy, v e e, v e dy, v dy dy; by colour (3); by depth
// Overrides: TILE DEPTH
// Twin: crates/gs-reference/src/rasterize_backward.rs

override DEPTH: bool;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> pair_index: array<u32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(5) var<storage, read> ends: array<u32>;
@group(0) @binding(6) var<storage, read> pixel_grads: array<f32>;
@group(0) @binding(7) var<storage, read_write> pair_grads: array<f32>;

// Per pixel of the tile: transmittance behind the Gaussian that it meets next, and the loss by what lies behind.
var<workgroup> transmittance: array<f32, TILE * TILE>;
var<workgroup> behind: array<f32, TILE * TILE>;
// Derivatives by colour and by Σ w z, and the place after the last pair.
var<workgroup> pixel_grad: array<vec4f, TILE * TILE>;
var<workgroup> pixel_end: array<u32, TILE * TILE>;
var<workgroup> tile_end: atomic<u32>;
var<workgroup> last_end: u32;

struct Sums {
    // v, v e, v dy
    first: vec3f,
    // v e e, v e dy, v dy dy
    second: vec3f,
    colour: vec3f,
    depth: f32,
}

@compute @workgroup_size(TILE, TILE)
fn rasterize_backward(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let belt = TILE * TILE;
    let origin = workgroup.xy * TILE;
    let range = ranges[workgroup.y * frame.tiles.x + workgroup.x];
    let pixel = origin + place.xy;
    pixel_end[local] = 0u;
    if all(pixel < frame.size) {
        let at = pixel.y * frame.size.x + pixel.x;
        let colour = vec3f(pixel_grads[at * 6u], pixel_grads[at * 6u + 1u], pixel_grads[at * 6u + 2u]);
        let left = pixel_grads[at * 6u + 5u];
        pixel_grad[local] = vec4f(colour, pixel_grads[at * 6u + 4u]);
        transmittance[local] = left;
        behind[local] = left * (dot(colour, frame.background) + pixel_grads[at * 6u + 3u]);
        pixel_end[local] = ends[at];
        atomicMax(&tile_end, ends[at]);
    }
    workgroupBarrier();
    if local == 0u {
        last_end = max(atomicLoad(&tile_end), range.x);
    }
    let end = workgroupUniformLoad(&last_end);
    let n_pairs = end - range.x;
    let n_rounds = (n_pairs + belt - 1u) / belt;
    let log2_alpha_min = log2(frame.alpha_min);

    var splat: Local;
    var sums: Sums;
    var sorted = 0u;
    var owns = false;
    // At step s invocation i meets pixel (s - i) mod belt: no two meet the same one.
    // The last pair meets the last pixel at step n_pairs + belt - 2.
    for (var step = 0u; step < n_pairs + belt - 1u && n_pairs > 0u; step++) {
        let time = step - local;
        if step >= local && time < n_rounds * belt {
            let met = time % belt;
            if met == 0u {
                let from_end = time + local;
                owns = from_end < n_pairs;
                if owns {
                    sorted = end - 1u - from_end;
                    splat = local_to(splats[pair_splats[pair_index[sorted]]], vec2f(origin));
                    sums = Sums();
                }
            }
            if owns && sorted < pixel_end[met] {
                let centre = vec2f(vec2u(met % TILE, met / TILE)) + vec2f(0.5);
                let alpha = alpha_at(splat.shape, centre, log2_alpha_min);
                if alpha.drawn {
                    meet(splat, alpha, met, &sums);
                }
            }
            if owns && met == belt - 1u {
                write_sums(pair_index[sorted], sums);
            }
        }
        workgroupBarrier();
    }
}

fn meet(splat: Local, alpha: Alpha, met: u32, sums: ptr<function, Sums>) {
    let rest = 1.0 - alpha.value;
    // Rounding must not let it grow beyond all light.
    let before = min(transmittance[met] / rest, 1.0);
    let weight = before * alpha.value;
    let grad = pixel_grad[met];
    var value = dot(grad.xyz, splat.rgb);
    (*sums).colour += weight * grad.xyz;
    if DEPTH {
        value += grad.w * splat.depth;
        (*sums).depth += weight * grad.w;
    }
    if !alpha.saturated {
        let v = -alpha.value * (before * value - behind[met] / rest);
        let e = alpha.offset.x;
        let dy = alpha.offset.y;
        (*sums).first += v * vec3f(1.0, e, dy);
        (*sums).second += v * vec3f(e * e, e * dy, dy * dy);
    }
    behind[met] += weight * value;
    transmittance[met] = before;
}

fn write_sums(pair: u32, sums: Sums) {
    let at = pair * 10u;
    for (var i = 0u; i < 3u; i++) {
        pair_grads[at + i] = sums.first[i];
        pair_grads[at + 3u + i] = sums.second[i];
        pair_grads[at + 6u + i] = sums.colour[i];
    }
    pair_grads[at + 9u] = sums.depth;
}
