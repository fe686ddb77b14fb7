// The projection of a Gaussian (EWA, Zwicker et al. 2001), shared by its forward and its backward pass. Users bind `frame`
// and `geometry`.

override ANTIALIAS: bool;

// Longest standard deviation of a footprint, pixels: longer axes are shortened. Over an image no falloff changes by more than
// rounding, and the fourth power of it fits f32.
const SIGMA_MAX: f32 = 1e9;

// A Gaussian with its parameters activated.
struct Activated {
    mean: vec3f,
    // Unit quaternion (w, x, y, z), and the norm of the stored one.
    quaternion: vec4f,
    norm: f32,
    // Columns are the local axes in the world.
    axes: mat3x3f,
    // Standard deviations, scene units.
    scale: vec3f,
    logit: f32,
    // Whether the quaternion is not zero and the scales do not overflow.
    valid: bool,
}

// A position as the camera sees it.
struct Seen {
    // Camera axes, scene units.
    p: vec3f,
    // x/z and y/z, and the same clamped to where the projection is linearised.
    slope: vec2f,
    clamped: vec2f,
}

// A footprint, and what its derivatives need.
struct Footprint {
    mean: vec2f,
    falloff: vec2f,
    shear: f32,
    // After compensation.
    opacity: f32,
    // Rows of the Jacobian of the projection times the camera's rotation, 1 pixel / scene unit.
    jacobian_u: vec3f,
    jacobian_v: vec3f,
    // Standard deviations after the limit of SIGMA_MAX.
    scale: vec3f,
    // Rows of V in the covariance V Vᵀ + eps2d I, pixels.
    u: vec3f,
    v: vec3f,
    // Determinants of V Vᵀ and of the covariance.
    det_sharp: f32,
    det: f32,
}

fn activated(index: u32) -> Activated {
    let at = index * 11u;
    var g: Activated;
    g.mean = vec3f(geometry[at], geometry[at + 1u], geometry[at + 2u]);
    let stored = vec4f(geometry[at + 3u], geometry[at + 4u], geometry[at + 5u], geometry[at + 6u]);
    // Scaled by the largest entry first: squares of small and of large entries leave the range of f32.
    let magnitude = abs(stored);
    let largest = max(max(magnitude.x, magnitude.y), max(magnitude.z, magnitude.w));
    let scaled = stored / largest;
    let scaled_norm = length(scaled);
    g.norm = largest * scaled_norm;
    g.quaternion = scaled / scaled_norm;
    let w = g.quaternion.x;
    let x = g.quaternion.y;
    let y = g.quaternion.z;
    let z = g.quaternion.w;
    g.axes = mat3x3f(
        vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
    g.scale = exp(vec3f(geometry[at + 7u], geometry[at + 8u], geometry[at + 9u]));
    g.logit = geometry[at + 10u];
    g.valid = largest > 0.0 && is_finite(g.quaternion.x) && is_finite(g.quaternion.y) && is_finite(g.quaternion.z)
        && is_finite(g.quaternion.w) && is_finite(g.scale.x) && is_finite(g.scale.y) && is_finite(g.scale.z);
    return g;
}

fn seen_at(mean: vec3f) -> Seen {
    var seen: Seen;
    for (var row = 0u; row < 3u; row++) {
        seen.p[row] = dot(frame.pose[row].xyz, mean) + frame.pose[row].w;
    }
    seen.slope = seen.p.xy / seen.p.z;
    seen.clamped = clamp(seen.slope, frame.slope_min, frame.slope_max);
    return seen;
}

fn footprint_of(gaussian: Activated, seen: Seen) -> Footprint {
    var f: Footprint;
    f.mean = frame.focal * seen.slope + frame.centre;
    let forward = frame.pose[2].xyz;
    f.jacobian_u = (frame.pose[0].xyz - forward * seen.clamped.x) * (frame.focal.x / seen.p.z);
    f.jacobian_v = (frame.pose[1].xyz - forward * seen.clamped.y) * (frame.focal.y / seen.p.z);
    f.scale = min(gaussian.scale, vec3f(SIGMA_MAX * seen.p.z / max(frame.focal.x, frame.focal.y)));
    f.u = (f.jacobian_u * gaussian.axes) * f.scale;
    f.v = (f.jacobian_v * gaussian.axes) * f.scale;
    // The determinant as a sum of positive terms (Cauchy-Binet): a c - b² would cancel for needles.
    let cross_uv = cross(f.u, f.v);
    let a = dot(f.u, f.u);
    let b = dot(f.u, f.v);
    let c = dot(f.v, f.v);
    f.det_sharp = dot(cross_uv, cross_uv);
    f.det = f.det_sharp + frame.eps2d * (a + c) + frame.eps2d * frame.eps2d;
    let filtered_c = c + frame.eps2d;
    f.falloff = vec2f(-0.5 * LOG2_E * (filtered_c / f.det), -0.5 * LOG2_E / filtered_c);
    f.shear = b / filtered_c;
    f.opacity = sigmoid(gaussian.logit);
    if ANTIALIAS {
        f.opacity *= max(sqrt(f.det_sharp / f.det), frame.compensation_min);
    }
    return f;
}

const LOG2_E: f32 = 1.4426950408889634;

// The logistic function; for large arguments of either sign 0 or 1.
fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-x));
}

// The length of a vector whose square may leave the range of f32.
fn long_length(v: vec3f) -> f32 {
    let magnitude = abs(v);
    let largest = max(max(magnitude.x, magnitude.y), magnitude.z);
    return largest * length(v / largest);
}
