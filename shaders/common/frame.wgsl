// What all passes of a view share; the Rust side is Frame in src/abi.rs.

struct Frame {
    // Rows of the world-to-camera matrix [R | t]; of this and of what else has a low part, what f32 leaves over.
    pose: array<vec4f, 3>,
    pose_low: array<vec4f, 3>,
    // Camera centre, scene units.
    position: vec3f,
    n_gaussians: u32,
    position_low: vec3f,
    // Gaussians are drawn between these z-depths, scene units.
    near: f32,
    // Pixels.
    focal: vec2f,
    focal_low: vec2f,
    centre: vec2f,
    centre_low: vec2f,
    // Least and largest x/z and y/z at which the projection is linearised.
    slope_min: vec2f,
    slope_max: vec2f,
    // Image, in pixels and in tiles.
    size: vec2u,
    tiles: vec2u,
    background: vec3f,
    far: f32,
    // Variance of the low-pass filter, square pixels.
    eps2d: f32,
    alpha_max: f32,
    alpha_min: f32,
    transmittance_min: f32,
    // Least factor of the compensation for the low-pass filter.
    compensation_min: f32,
    // Pairs of Gaussian and tile for which there is room.
    pair_capacity: u32,
    // 0, which no compiler can know.
    zero: u32,
    // Size at which ellipsoids are drawn, standard deviations.
    ellipsoid_sigma: f32,
}

// The footprint of a Gaussian. In a pixel at (dx, dy) from the centre, with e = dx - shear dy,
// log2 of alpha is log2_opacity + falloff.x e e + falloff.y dy dy. Terms of one sign: the conic's A dx² + 2 B dx dy + C dy²
// would cancel for needles.
struct Splat {
    // Pixels, and what f32 leaves over of it.
    mean: vec2f,
    mean_low: vec2f,
    // 1 / square pixels.
    falloff: vec2f,
    shear: f32,
    shear_low: f32,
    log2_opacity: f32,
    red: f32,
    green: f32,
    blue: f32,
    // z-depth of the centre, scene units.
    depth: f32,
    padding: f32,
}

// A Gaussian as an ellipsoid, in the affine view in which its footprint is an ellipse: with e = dx - shear dy and the exponent
// m = A e² + g dy² of the footprint, its front is at z-depth
// depth + slope_e e + slope_y dy - sigma_z √(ellipsoid_sigma² - m).
struct Surface {
    // Scene units / pixel.
    slope_e: f32,
    slope_y: f32,
    // Standard deviation along the ray, scene units.
    sigma_z: f32,
    padding: f32,
}

// Slots of the counters.
const VISIBLE: u32 = 0;
const REJECTED: u32 = 1;
const N_PAIRS: u32 = 2;
// No slot.
const NOWHERE: u32 = 0xffffffffu;

// Position of a workgroup in a one-dimensional grid that was folded to keep to the limit of 65535 per dimension.
fn folded(workgroup: vec3u, grid: vec3u) -> u32 {
    return workgroup.y * grid.x + workgroup.x;
}

// False for NaN and infinities; on the bits, because a compiler may assume that there are none.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}
