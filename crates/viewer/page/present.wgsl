// present: the pixels of a view as 8-bit colours for a canvas.
// One invocation: one pixel. Dispatch: pixels / 256, folded.

struct Paint {
    pixels: u32,
    // 0 colour, 1 depth, 2 opacity.
    mode: u32,
    // 1 / z-depth of white and of black.
    near: f32,
    far: f32,
}

@group(0) @binding(0) var<uniform> paint: Paint;
// [h, w, 4] colour and transmittance; with depth [h, w] Σ w and [h, w] Σ w z after that.
@group(0) @binding(1) var<storage, read> pixels: array<f32>;
// [h, w] red, green, blue, 255.
@group(0) @binding(2) var<storage, read_write> shown: array<u32>;

@compute @workgroup_size(256)
fn present(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = (workgroup.y * grid.x + workgroup.x) * 256u + local;
    if at < paint.pixels {
        shown[at] = pack4x8unorm(vec4f(colour(at), 1.0));
    }
}

fn colour(at: u32) -> vec3f {
    if paint.mode == 1u {
        let weight = pixels[4u * paint.pixels + at];
        if weight <= 0.0 {
            return vec3f(0.0);
        }
        let inverse = weight / pixels[5u * paint.pixels + at];
        return vec3f(0.06 + 0.94 * clamp((inverse - paint.far) / (paint.near - paint.far), 0.0, 1.0));
    }
    if paint.mode == 2u {
        return vec3f(1.0 - pixels[4u * at + 3u]);
    }
    return vec3f(pixels[4u * at], pixels[4u * at + 1u], pixels[4u * at + 2u]);
}
