// rasterize_ellipsoids: the nearest ellipsoid in each pixel, lit from the camera.
// One workgroup: one tile, one invocation a pixel. Dispatch: tiles.x × tiles.y.
// Bindings:
//   0 frame        uniform      Frame
//   1 splats       read         [n] Splat
//   2 pair_splats  read         [pairs] index of the Gaussian
//   3 pair_index   read         [pairs] sorted by tile, within a tile near to far by the centres
//   4 ranges       read         [tiles] first pair and the one after the last
//   5 surfaces     read         [n] Surface
//   6 pixels       read_write   [h, w, 4] colour over the background, 1 where there is no ellipsoid else 0; [h, w] 1 where there is
//                               one else 0; [h, w] z-depth of the front, 0 where there is none
// Overrides: TILE
// Twin: crates/gs-reference/src/rasterize_ellipsoids.rs

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read> pair_index: array<u32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(5) var<storage, read> surfaces: array<Surface>;
@group(0) @binding(6) var<storage, read_write> pixels: array<f32>;

// Share of the colour that a surface keeps which is seen edge-on.
const AMBIENT: f32 = 0.3;

@compute @workgroup_size(TILE, TILE)
fn rasterize_ellipsoids(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_id) place: vec3u) {
    let pixel = workgroup.xy * TILE + place.xy;
    if any(pixel >= frame.size) {
        return;
    }
    let range = ranges[workgroup.y * frame.tiles.x + workgroup.x];
    let origin = vec2f(workgroup.xy * TILE);
    let centre = vec2f(place.xy) + vec2f(0.5);
    let log2_alpha_min = log2(frame.alpha_min);
    var nearest = frame.far;
    var colour = frame.background;
    for (var pair = range.x; pair < range.y; pair++) {
        let index = pair_splats[pair_index[pair]];
        let splat = splats[index];
        let local = local_to(splat, origin);
        let alpha = alpha_at(local.shape, centre, log2_alpha_min);
        if alpha.drawn {
            let surface = surfaces[index];
            let a = -2.0 * LN_2 * splat.falloff.x;
            let g = -2.0 * LN_2 * splat.falloff.y;
            let e = alpha.offset.x;
            let dy = alpha.offset.y;
            let sigma = frame.ellipsoid_sigma;
            let rise = sqrt(max(sigma * sigma - a * e * e - g * dy * dy, 0.0));
            let front = splat.depth + surface.slope_e * e + surface.slope_y * dy - surface.sigma_z * rise;
            // Equal fronts: the nearer centre, which comes first.
            if front > frame.near && front < nearest {
                nearest = front;
                // Slope of the front in e and dy, times `rise`, which is 0 at the rim.
                let by_e = surface.slope_e * rise + surface.sigma_z * a * e;
                let by_y = surface.slope_y * rise + surface.sigma_z * g * dy - splat.shear * by_e;
                colour = local.rgb * lit(splat, vec2f(pixel) + vec2f(0.5), vec2f(by_e, by_y), rise);
            }
        }
    }
    let at = pixel.y * frame.size.x + pixel.x;
    let n_pixels = frame.size.x * frame.size.y;
    let hit = nearest < frame.far;
    pixels[at * 4u] = colour.r;
    pixels[at * 4u + 1u] = colour.g;
    pixels[at * 4u + 2u] = colour.b;
    pixels[at * 4u + 3u] = select(1.0, 0.0, hit);
    pixels[n_pixels * 4u + at] = select(0.0, 1.0, hit);
    pixels[n_pixels * 5u + at] = select(0.0, nearest, hit);
}

const LN_2: f32 = 0.6931471805599453;

// Brightness of a front whose slope in the image, times `rise`, is `slope`, lit by a lamp at the camera.
fn lit(splat: Splat, pixel: vec2f, slope: vec2f, rise: f32) -> f32 {
    let ray = vec3f((pixel - frame.centre) / frame.focal, 1.0);
    // The front's normal, from image coordinates and depth to camera axes by the transposed Jacobian at the centre.
    let centre = (splat.mean - frame.centre) / frame.focal;
    let across = slope * frame.focal / splat.depth;
    let normal = vec3f(-across, rise + dot(across, centre));
    let cosine = abs(dot(normal, ray)) / max(length(normal) * length(ray), 1e-30);
    return AMBIENT + (1.0 - AMBIENT) * min(cosine, 1.0);
}
