// project_backward: derivatives by what is stored of the Gaussians, and by the pose.
// One invocation: one Gaussian, in the order of depth. Dispatch: n_gaussians / WORKGROUP, folded.
// Bindings:
//   0 frame          uniform      Frame
//   1 geometry       read         [n, 11] stored columns
//   2 sh             read         [n, (SH_DEGREE + 1)², 3]
//   3 order          read         [n] indices of Gaussians, the visible ones first, near to far
//   4 offsets        read         [n + 1] place of the first pair of each
//   5 pair_grads     read         [pairs, 10] as rasterize_backward writes them
//   6 grad_geometry  read_write   [n, 11] added to
//   7 grad_sh        read_write   [n, (SH_DEGREE + 1)², 3] added to
//   8 pose_sums      read_write   [workgroups, 15] by a turn and stretch D of the camera's axes, p <- D p (9),
//                                 by t (3), and by the camera centre through colours (3)
// Overrides: WORKGROUP SH_DEGREE ANTIALIAS
// Twin: crates/gs-reference/src/project_backward.rs

override WORKGROUP: u32;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> geometry: array<f32>;
@group(0) @binding(2) var<storage, read> sh: array<f32>;
@group(0) @binding(3) var<storage, read> order: array<u32>;
@group(0) @binding(4) var<storage, read> offsets: array<u32>;
@group(0) @binding(5) var<storage, read> pair_grads: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_geometry: array<f32>;
@group(0) @binding(7) var<storage, read_write> grad_sh: array<f32>;
@group(0) @binding(8) var<storage, read_write> pose_sums: array<f32>;

const LN_2: f32 = 0.6931471805599453;
const POSE_SUMS: u32 = 15;
// Pairs that are summed by themselves.
const PARTIAL: u32 = 64;

// What one Gaussian adds to the derivatives by the pose.
struct Pose {
    axes: array<vec3f, 3>,
    p: vec3f,
    centre: vec3f,
}

var<workgroup> partial: array<f32, WORKGROUP>;

@compute @workgroup_size(WORKGROUP)
fn project_backward(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) grid: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let group = folded(workgroup, grid);
    let rank = group * WORKGROUP + local;
    var pose: Pose;
    if rank < frame.n_gaussians {
        let first = offsets[rank];
        let end = offsets[rank + 1u];
        if first < end {
            var sums: array<f32, 10>;
            // A sum of sums: of thousands of pairs in a row the first ones would be rounded thousands of times.
            for (var start = first; start < end; start += PARTIAL) {
                var part: array<f32, 10>;
                for (var pair = start; pair < min(start + PARTIAL, end); pair++) {
                    for (var i = 0u; i < 10u; i++) {
                        part[i] += pair_grads[pair * 10u + i];
                    }
                }
                for (var i = 0u; i < 10u; i++) {
                    sums[i] += part[i];
                }
            }
            pose = differentiate(order[rank], sums);
        }
    }
    if group * WORKGROUP >= frame.n_gaussians {
        return;
    }
    for (var i = 0u; i < POSE_SUMS; i++) {
        var value = 0.0;
        if i < 9u {
            value = pose.axes[i / 3u][i % 3u];
        } else if i < 12u {
            value = pose.p[i - 9u];
        } else {
            value = pose.centre[i - 12u];
        }
        partial[local] = value;
        for (var half = WORKGROUP / 2u; half > 0u; half /= 2u) {
            workgroupBarrier();
            if local < half {
                partial[local] = defined_sum(partial[local], partial[local + half]);
            }
        }
        workgroupBarrier();
        if local == 0u {
            pose_sums[group * POSE_SUMS + i] = partial[0];
        }
        workgroupBarrier();
    }
}

fn differentiate(index: u32, sums: array<f32, 10>) -> Pose {
    let gaussian = activated(index);
    let seen = seen_at(gaussian.mean);
    let f = footprint_of(gaussian, seen);
    let inverse_z = 1.0 / seen.p.z;

    // The exponent is (A e² + g dy²) / 2 with e = dx - shear dy.
    let a = -2.0 * LN_2 * f.falloff.x;
    let g = -2.0 * LN_2 * f.falloff.y;
    let h = f.shear.x;
    let grad_mean = vec2f(-a * sums[1], a * h * sums[1] - g * sums[2]);
    // By the rows of V.
    let aee = a * a * sums[3];
    let aey = g * a * sums[4];
    let gyy = g * g * sums[5];
    var grad_u = -aee * f.w - aey * f.v;
    var grad_v = h * aee * f.w - aey * (f.w - h * f.v) - gyy * f.v;
    // P = Vᵀ (derivative by V) is symmetric, and P / (scaleᵢ scaleⱼ) stays finite however flat the Gaussian is: its diagonal is the
    // derivative by the logarithms of the scales, the rest, (yz, xz, xy), that by a turn. By a turn of a ball it is exactly 0.
    let w = f.unit_w;
    let v = f.unit_v;
    let square = f.scale * f.scale;
    var diagonal = -square * (aee * w * w + 2.0 * aey * w * v + gyy * v * v);
    var mixed = -(aee * w.yxx * w.zzy + aey * (w.yxx * v.zzy + w.zzy * v.yxx) + gyy * v.yxx * v.zzy);

    let grad_ln_opacity = -sums[0];
    if ANTIALIAS {
        let ratio = f.det_sharp / f.det;
        if ratio > frame.compensation_min * frame.compensation_min {
            // Half the logarithm of det_sharp / det: of the one the derivative P is the projector onto the rows of V, of the other
            // there remains the filter's share.
            let cross_uv = cross(f.w, f.v);
            let by_sharp = grad_ln_opacity * (1.0 - ratio);
            let by_filter = grad_ln_opacity * frame.eps2d / f.det;
            grad_u += by_sharp / f.det_sharp * cross(f.v, cross_uv) - by_filter * f.u;
            grad_v += by_sharp / f.det_sharp * cross(cross_uv, f.u) - by_filter * f.v;
            let u = w + h * v;
            let normal = cross_uv * inverseSqrt(f.det_sharp);
            let unit_cross = cross(w, v);
            diagonal += by_sharp * (vec3f(1.0) - normal * normal) - by_filter * square * (u * u + v * v);
            mixed -= by_sharp / f.det_sharp * square * unit_cross.yxx * unit_cross.zzy
                + by_filter * (u.yxx * u.zzy + v.yxx * v.zzy);
        }
    }
    let limited = gaussian.scale > f.scale;
    let grad_log_scale = select(diagonal, vec3f(0.0), limited);
    let turn = mixed * (f.scale.yzx - f.scale.zxy) * (f.scale.yzx + f.scale.zxy);

    // Rows of V are (jacobian · axes) scale.
    let axes = mat3x3f(gaussian.axes[0].high, gaussian.axes[1].high, gaussian.axes[2].high);
    let grad_jacobian_u = axes * (grad_u * f.scale);
    let grad_jacobian_v = axes * (grad_v * f.scale);

    // Position in camera axes: through the centre, the depth, the slope at which the Jacobian stands, and its 1/z.
    let forward = frame.pose[2].xyz;
    let focal_z = frame.focal * inverse_z;
    let grad_clamped = -focal_z * vec2f(dot(forward, grad_jacobian_u), dot(forward, grad_jacobian_v));
    let slope = vec2f(seen.slope_x.x, seen.slope_y.x);
    let grad_slope = grad_mean * frame.focal + select(vec2f(0.0), grad_clamped, seen.is_free);
    let grad_z = sums[9] - inverse_z
        * (dot(grad_slope, slope) + dot(grad_jacobian_u, f.jacobian_u) + dot(grad_jacobian_v, f.jacobian_v));
    let grad_p = vec3f(grad_slope * inverse_z, grad_z);

    // Colour.
    let offset = from_camera(gaussian.mean);
    let distance = long_length(offset);
    let direction = offset / distance;
    let basis = sh_basis(direction);
    var colour = vec3f(0.5);
    for (var k = 0u; k < sh_coefficients(); k++) {
        colour += basis[k] * sh_at(index, k);
    }
    let grad_colour = select(vec3f(0.0), vec3f(sums[6], sums[7], sums[8]), colour >= vec3f(0.0));
    for (var k = 0u; k < sh_coefficients(); k++) {
        let at = (index * sh_coefficients() + k) * 3u;
        for (var channel = 0u; channel < 3u; channel++) {
            grad_sh[at + channel] = defined_sum(grad_sh[at + channel], basis[k] * grad_colour[channel]);
        }
    }
    var grad_direction = sh_gradient(index, direction, grad_colour);
    grad_direction = (grad_direction - direction * dot(direction, grad_direction)) / distance;

    let grad_world = grad_p.x * frame.pose[0].xyz + grad_p.y * frame.pose[1].xyz + grad_p.z * forward + grad_direction;
    let q = gaussian.quaternion;
    let grad_quaternion = 2.0 / gaussian.norm * vec4f(-dot(q.yzw, turn), q.x * turn + cross(q.yzw, turn));
    let grad_logit = grad_ln_opacity * sigmoid(-gaussian.logit);
    let at = index * 11u;
    for (var i = 0u; i < 3u; i++) {
        grad_geometry[at + i] = defined_sum(grad_geometry[at + i], grad_world[i]);
        grad_geometry[at + 7u + i] = defined_sum(grad_geometry[at + 7u + i], grad_log_scale[i]);
    }
    for (var i = 0u; i < 4u; i++) {
        grad_geometry[at + 3u + i] = defined_sum(grad_geometry[at + 3u + i], grad_quaternion[i]);
    }
    grad_geometry[at + 10u] = defined_sum(grad_geometry[at + 10u], grad_logit);

    var pose: Pose;
    let by_u = grad_jacobian_u * focal_z.x;
    let by_v = grad_jacobian_v * focal_z.y;
    // In camera axes, in which numbers are as large as the distance, not as the world.
    pose.axes[0] = all_defined(grad_p.x * seen.p + in_camera_axes(by_u));
    pose.axes[1] = all_defined(grad_p.y * seen.p + in_camera_axes(by_v));
    pose.axes[2] = all_defined(
        grad_p.z * seen.p - in_camera_axes(seen.clamped_x.x * by_u + seen.clamped_y.x * by_v));
    pose.p = all_defined(grad_p);
    pose.centre = all_defined(-grad_direction);
    return pose;
}

fn in_camera_axes(v: vec3f) -> vec3f {
    return vec3f(dot(frame.pose[0].xyz, v), dot(frame.pose[1].xyz, v), dot(frame.pose[2].xyz, v));
}

fn sh_at(index: u32, k: u32) -> vec3f {
    let at = (index * sh_coefficients() + k) * 3u;
    return vec3f(sh[at], sh[at + 1u], sh[at + 2u]);
}

// By the direction from which the colour is seen.
fn sh_gradient(index: u32, d: vec3f, grad_colour: vec3f) -> vec3f {
    var grad = vec3f(0.0);
    if SH_DEGREE >= 1u {
        grad.y -= SH_C1 * dot(sh_at(index, 1u), grad_colour);
        grad.z += SH_C1 * dot(sh_at(index, 2u), grad_colour);
        grad.x -= SH_C1 * dot(sh_at(index, 3u), grad_colour);
    }
    if SH_DEGREE >= 2u {
        grad += SH_C2_XY * dot(sh_at(index, 4u), grad_colour) * vec3f(d.y, d.x, 0.0);
        grad -= SH_C2_XY * dot(sh_at(index, 5u), grad_colour) * vec3f(0.0, d.z, d.y);
        grad += SH_C2_ZZ * dot(sh_at(index, 6u), grad_colour) * vec3f(-2.0 * d.x, -2.0 * d.y, 4.0 * d.z);
        grad -= SH_C2_XY * dot(sh_at(index, 7u), grad_colour) * vec3f(d.z, 0.0, d.x);
        grad += SH_C2_XX * dot(sh_at(index, 8u), grad_colour) * vec3f(2.0 * d.x, -2.0 * d.y, 0.0);
    }
    if SH_DEGREE >= 3u {
        let xx = d.x * d.x;
        let yy = d.y * d.y;
        let zz = d.z * d.z;
        let xy = d.x * d.y;
        let yz = d.y * d.z;
        let xz = d.x * d.z;
        grad += SH_C3_Y3 * dot(sh_at(index, 9u), grad_colour) * vec3f(6.0 * xy, 3.0 * (xx - yy), 0.0);
        grad += SH_C3_XYZ * dot(sh_at(index, 10u), grad_colour) * vec3f(yz, xz, xy);
        grad += SH_C3_YZZ * dot(sh_at(index, 11u), grad_colour) * vec3f(-2.0 * xy, 4.0 * zz - xx - 3.0 * yy, 8.0 * yz);
        grad += SH_C3_ZZZ * dot(sh_at(index, 12u), grad_colour)
            * vec3f(-6.0 * xz, -6.0 * yz, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        grad += SH_C3_YZZ * dot(sh_at(index, 13u), grad_colour) * vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * xy, 8.0 * xz);
        grad += SH_C3_ZXX * dot(sh_at(index, 14u), grad_colour) * vec3f(2.0 * xz, -2.0 * yz, xx - yy);
        grad += SH_C3_Y3 * dot(sh_at(index, 15u), grad_colour) * vec3f(3.0 * (xx - yy), -6.0 * xy, 0.0);
    }
    return grad;
}

// A derivative that left the range of f32 on the way is not known: it counts as zero rather than to spoil every sum.
fn defined(x: f32) -> f32 {
    return select(0.0, x, is_finite(x));
}

// What would leave the range of f32 is not added, for the same reason.
fn defined_sum(sum: f32, x: f32) -> f32 {
    let total = sum + x;
    return select(sum, total, is_finite(total));
}

fn all_defined(v: vec3f) -> vec3f {
    return vec3f(defined(v.x), defined(v.y), defined(v.z));
}
