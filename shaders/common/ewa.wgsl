// The projection of a Gaussian (EWA, Zwicker et al. 2001), shared by its forward and its backward pass. Users bind `frame`
// and `geometry`.

override ANTIALIAS: bool;

// Longest standard deviation of a footprint, pixels: longer axes are shortened. Over an image no falloff changes by more than
// rounding, and the fourth power of it fits f32.
const SIGMA_MAX: f32 = 1e9;
const LOG2_E: f32 = 1.4426950408889634;

// A Gaussian with its parameters activated.
struct Activated {
    mean: vec3f,
    // Unit quaternion (w, x, y, z), and the norm of the stored one.
    quaternion: vec4f,
    norm: f32,
    // Local axes in the world.
    axes: array<Two3, 3>,
    // Standard deviations, scene units.
    scale: vec3f,
    logit: f32,
    // Whether the quaternion is not zero (denormal counts as zero) and the scales do not overflow.
    valid: bool,
}

// A position as the camera sees it.
struct Seen {
    // Camera axes, scene units.
    p: vec3f,
    z: vec2f,
    // x/z and y/z, and the same clamped to where the projection is linearised.
    slope_x: vec2f,
    slope_y: vec2f,
    clamped_x: vec2f,
    clamped_y: vec2f,
    // Whether they are not clamped.
    is_free: vec2<bool>,
}

// A footprint, and what its derivatives need.
struct Footprint {
    // Centre, pixels: high and low parts of x and of y.
    x: vec2f,
    y: vec2f,
    falloff: vec2f,
    // High and low part.
    shear: vec2f,
    // After compensation.
    opacity: f32,
    // Rows of the Jacobian of the projection times the camera's rotation, pixels / scene unit.
    jacobian_u: vec3f,
    jacobian_v: vec3f,
    // Standard deviations after the limit of SIGMA_MAX.
    scale: vec3f,
    // Rows of V in the covariance V Vᵀ + eps2d I, for unit scales, pixels / scene unit: row 1, and row 0 without shear times
    // row 1, which is small where they cancel.
    unit_v: vec3f,
    unit_w: vec3f,
    // The same for the Gaussian's scales, and row 0, pixels.
    u: vec3f,
    v: vec3f,
    w: vec3f,
    // Determinants of V Vᵀ and of the covariance.
    det_sharp: f32,
    det: f32,
}

fn activated(index: u32) -> Activated {
    let at = index * 11u;
    var g: Activated;
    g.mean = vec3f(geometry[at], geometry[at + 1u], geometry[at + 2u]);
    let stored = vec4f(geometry[at + 3u], geometry[at + 4u], geometry[at + 5u], geometry[at + 6u]);
    let magnitude = abs(stored);
    let largest = max(max(magnitude.x, magnitude.y), max(magnitude.z, magnitude.w));
    // Scaled by a power of two, exactly: squares of small and of large entries leave the range of f32.
    let exponent = bitcast<u32>(largest) >> 23u;
    let to_one = bitcast<f32>(max(254u - min(exponent, 254u), 1u) << 23u);
    let q = stored * to_one;
    let norm = length(q);
    g.norm = norm / to_one;
    g.quaternion = q / norm;
    let squares = add(add(two_product(q.x, q.x), two_product(q.y, q.y)), add(two_product(q.z, q.z), two_product(q.w, q.w)));
    let s = divide(vec2f(2.0, 0.0), squares);
    let one = vec2f(1.0, 0.0);
    let wx = multiply(s, two_product(q.x, q.y));
    let wy = multiply(s, two_product(q.x, q.z));
    let wz = multiply(s, two_product(q.x, q.w));
    let xx = multiply(s, two_product(q.y, q.y));
    let xy = multiply(s, two_product(q.y, q.z));
    let xz = multiply(s, two_product(q.y, q.w));
    let yy = multiply(s, two_product(q.z, q.z));
    let yz = multiply(s, two_product(q.z, q.w));
    let zz = multiply(s, two_product(q.w, q.w));
    g.axes[0] = two3(add(one, -add(yy, zz)), add(xy, wz), add(xz, -wy));
    g.axes[1] = two3(add(xy, -wz), add(one, -add(xx, zz)), add(yz, wx));
    g.axes[2] = two3(add(xz, wy), add(yz, -wx), add(one, -add(xx, yy)));
    g.scale = exp(vec3f(geometry[at + 7u], geometry[at + 8u], geometry[at + 9u]));
    g.logit = geometry[at + 10u];
    g.valid = exponent > 0u && is_finite(g.scale.x) && is_finite(g.scale.y) && is_finite(g.scale.z);
    return g;
}

// A row of the camera's rotation.
fn rotation_row(row: u32) -> Two3 {
    return Two3(frame.pose[row].xyz, frame.pose_low[row].xyz);
}

fn seen_at(mean: vec3f) -> Seen {
    let m = Two3(mean, vec3f(0.0));
    let x = add(dot3(rotation_row(0u), m), vec2f(frame.pose[0].w, frame.pose_low[0].w));
    let y = add(dot3(rotation_row(1u), m), vec2f(frame.pose[1].w, frame.pose_low[1].w));
    var seen: Seen;
    seen.z = add(dot3(rotation_row(2u), m), vec2f(frame.pose[2].w, frame.pose_low[2].w));
    seen.p = vec3f(x.x, y.x, seen.z.x);
    seen.slope_x = divide(x, seen.z);
    seen.slope_y = divide(y, seen.z);
    let slope = vec2f(seen.slope_x.x, seen.slope_y.x);
    let clamped = clamp(slope, frame.slope_min, frame.slope_max);
    seen.is_free = slope == clamped;
    seen.clamped_x = select(vec2f(clamped.x, 0.0), seen.slope_x, seen.is_free.x);
    seen.clamped_y = select(vec2f(clamped.y, 0.0), seen.slope_y, seen.is_free.y);
    return seen;
}

fn footprint_of(gaussian: Activated, seen: Seen) -> Footprint {
    let focal_x = vec2f(frame.focal.x, frame.focal_low.x);
    let focal_y = vec2f(frame.focal.y, frame.focal_low.y);
    var f: Footprint;
    f.x = add(multiply(focal_x, seen.slope_x), vec2f(frame.centre.x, frame.centre_low.x));
    f.y = add(multiply(focal_y, seen.slope_y), vec2f(frame.centre.y, frame.centre_low.y));
    let forward = rotation_row(2u);
    let jacobian_u = scale3(add3(rotation_row(0u), scale3(forward, -seen.clamped_x)), divide(focal_x, seen.z));
    let jacobian_v = scale3(add3(rotation_row(1u), scale3(forward, -seen.clamped_y)), divide(focal_y, seen.z));
    f.jacobian_u = jacobian_u.high;
    f.jacobian_v = jacobian_v.high;
    f.scale = min(gaussian.scale, vec3f(SIGMA_MAX * seen.p.z / max(frame.focal.x, frame.focal.y)));
    let unit_u = along_axes(jacobian_u, gaussian);
    let unit_v = along_axes(jacobian_v, gaussian);
    let u = scaled_by(unit_u, f.scale);
    let v = scaled_by(unit_v, f.scale);
    let b = dot3(u, v);
    let filtered_c = add(dot3(v, v), vec2f(frame.eps2d, 0.0));
    f.shear = divide(b, filtered_c);
    f.u = u.high;
    f.v = v.high;
    f.unit_v = unit_v.high;
    f.unit_w = add3(unit_u, scale3(unit_v, -f.shear)).high;
    f.w = f.unit_w * f.scale;
    // The determinant as a sum of positive terms (Cauchy-Binet): a c - b² would cancel for needles. For the cross product u
    // may be replaced by w, which is what of it does not lie along v.
    let cross_uv = cross(f.w, f.v);
    let a = dot(f.u, f.u);
    let c = dot(f.v, f.v);
    f.det_sharp = dot(cross_uv, cross_uv);
    f.det = f.det_sharp + frame.eps2d * (a + c) + frame.eps2d * frame.eps2d;
    f.falloff = vec2f(-0.5 * LOG2_E * (filtered_c.x / f.det), -0.5 * LOG2_E / filtered_c.x);
    f.opacity = sigmoid(gaussian.logit);
    if ANTIALIAS {
        f.opacity *= max(sqrt(f.det_sharp / f.det), frame.compensation_min);
    }
    return f;
}

fn along_axes(row: Two3, gaussian: Activated) -> Two3 {
    return two3(dot3(row, gaussian.axes[0]), dot3(row, gaussian.axes[1]), dot3(row, gaussian.axes[2]));
}

fn scaled_by(row: Two3, scale: vec3f) -> Two3 {
    return two3(
        multiply(entry(row, 0u), vec2f(scale.x, 0.0)),
        multiply(entry(row, 1u), vec2f(scale.y, 0.0)),
        multiply(entry(row, 2u), vec2f(scale.z, 0.0)),
    );
}

// The logistic function; for large arguments of either sign 0 or 1.
fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-x));
}

// From the camera to a position.
fn from_camera(mean: vec3f) -> vec3f {
    return add3(Two3(mean, vec3f(0.0)), Two3(-frame.position, -frame.position_low)).high;
}

// The length of a vector whose square may leave the range of f32.
fn long_length(v: vec3f) -> f32 {
    let magnitude = abs(v);
    let largest = max(max(magnitude.x, magnitude.y), magnitude.z);
    return largest * length(v / largest);
}
