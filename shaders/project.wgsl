// project: a Gaussian to its footprint in the image. project_ellipsoids: to that of its ellipsoid, and its front.
// One invocation: one Gaussian. Dispatch: n_gaussians / WORKGROUP, folded.
// Bindings:
//   0 frame       uniform      Frame
//   1 geometry    read         [n, 11] stored columns
//   2 sh          read         [n, (SH_DEGREE + 1)², 3]
//   3 splats      read_write   [n] Splat; untouched where the Gaussian is not visible
//   4 depth_keys  read_write   [n] bits of the z-depth, CULLED where the Gaussian is not visible
//   5 order       read_write   [n] own index, to be sorted by depth
//   6 counters    read_write   [3] VISIBLE and REJECTED are added to
//   7 surfaces    read_write   [n] Surface; untouched where the Gaussian is not visible
// Overrides: WORKGROUP TILE SH_DEGREE ANTIALIAS
// Twin: crates/gs-reference/src/project.rs

override WORKGROUP: u32;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> geometry: array<f32>;
@group(0) @binding(2) var<storage, read> sh: array<f32>;
@group(0) @binding(3) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(4) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> order: array<u32>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> surfaces: array<Surface>;

// Sorts behind every depth.
const CULLED: u32 = 0xffffffffu;

@compute @workgroup_size(WORKGROUP)
fn project(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = folded(workgroup, grid) * WORKGROUP + local;
    if index < frame.n_gaussians {
        _ = is_placed(index, false);
    }
}

@compute @workgroup_size(WORKGROUP)
fn project_ellipsoids(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let index = folded(workgroup, grid) * WORKGROUP + local;
    if index >= frame.n_gaussians || !is_placed(index, true) {
        return;
    }
    let gaussian = activated(index);
    let f = footprint_of(gaussian, seen_at(gaussian.mean));
    let along_z = along_axes(rotation_row(2u), gaussian).high * f.scale;
    let a = -2.0 / LOG2_E * f.falloff.x;
    let g = -2.0 / LOG2_E * f.falloff.y;
    let with_e = dot(f.w, along_z);
    let with_y = dot(f.v, along_z);
    let slope = vec2f(a * with_e, g * with_y);
    // What is left of z once the pixel is given, along the Gaussian's axes and those of the low-pass filter: as a sum of
    // squares, because the difference of variances cancels for flat Gaussians.
    let rest = along_z - slope.x * f.w - slope.y * f.v;
    let filtered = vec2f(slope.x, slope.y - f.shear.x * slope.x);
    let variance = dot(rest, rest) + frame.eps2d * dot(filtered, filtered);
    surfaces[index] = Surface(slope.x, slope.y, sqrt(variance), 0.0);
}

// Writes the footprint of a Gaussian if it is visible, and says whether it is.
fn is_placed(index: u32, as_ellipsoid: bool) -> bool {
    order[index] = index;
    depth_keys[index] = CULLED;
    var finite = true;
    for (var column = 0u; column < 11u; column++) {
        finite = finite && is_finite(geometry[index * 11u + column]);
    }
    if !finite {
        atomicAdd(&counters[REJECTED], 1u);
        return false;
    }
    let gaussian = activated(index);
    let seen = seen_at(gaussian.mean);
    if !(seen.p.z > frame.near && seen.p.z < frame.far) {
        return false;
    }
    if !gaussian.valid {
        atomicAdd(&counters[REJECTED], 1u);
        return false;
    }
    let footprint = footprint_of(gaussian, seen);
    // NaN fails the comparison, and a footprint that is not finite fails the test below. Ellipsoids are opaque, but for
    // those that alpha_min leaves out.
    if footprint.opacity < frame.alpha_min {
        return false;
    }
    let offset = from_camera(gaussian.mean);
    let direction = offset / long_length(offset);
    let basis = sh_basis(direction);
    var colour = vec3f(0.5);
    for (var k = 0u; k < sh_coefficients(); k++) {
        let at = (index * sh_coefficients() + k) * 3u;
        colour += basis[k] * vec3f(sh[at], sh[at + 1u], sh[at + 2u]);
    }
    var splat = Splat(
        vec2f(footprint.x.x, footprint.y.x),
        vec2f(footprint.x.y, footprint.y.y),
        footprint.falloff,
        footprint.shear.x,
        footprint.shear.y,
        log2(footprint.opacity),
        max(colour.r, 0.0),
        max(colour.g, 0.0),
        max(colour.b, 0.0),
        seen.p.z,
        0.0,
    );
    if as_ellipsoid {
        splat.log2_opacity = log2(frame.alpha_min) + 0.5 * LOG2_E * frame.ellipsoid_sigma * frame.ellipsoid_sigma;
    }
    let ellipse = ellipse_of(splat, log2(frame.alpha_min));
    if !(is_finite(splat.mean.x) && is_finite(splat.mean.y) && is_finite(splat.falloff.x) && is_finite(splat.falloff.y)
        && is_finite(splat.shear) && is_finite(splat.log2_opacity) && is_finite(ellipse.extent.x)
        && is_finite(ellipse.extent.y) && splat.falloff.x < 0.0 && splat.falloff.y < 0.0) {
        atomicAdd(&counters[REJECTED], 1u);
        return false;
    }
    let slack = REACH_SLACK * (abs(splat.mean) + ellipse.extent);
    let low = splat.mean - ellipse.extent - slack;
    let high = splat.mean + ellipse.extent + slack;
    if !(all(high >= vec2f(0.5)) && all(low <= vec2f(frame.size) - vec2f(0.5))) {
        return false;
    }
    if !(is_finite(colour.r) && is_finite(colour.g) && is_finite(colour.b)) {
        atomicAdd(&counters[REJECTED], 1u);
        return false;
    }
    splats[index] = splat;
    depth_keys[index] = bitcast<u32>(seen.p.z);
    atomicAdd(&counters[VISIBLE], 1u);
    return true;
}
