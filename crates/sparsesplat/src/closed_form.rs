//! The head without weights: every attribute of a Gaussian by formula from the patch that its anchor stands for.

use crate::cells::Cell;
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_scene::{Camera, Gaussians, dc_from_rgb, logit};

/// Variance of the Gaussian over variance of its cell. A square cell of side a has a standard deviation of 0.289 a;
/// neighbours at distance a join without gaps when the Gaussian's is 0.55 a.
const SPREAD: f64 = 3.6;
/// Thickness of the disc over the smaller of its two standard deviations.
const THICKNESS: f64 = 0.15;
/// Cosine between normal and viewing ray below which a disc is turned towards the camera: a grazing one would be
/// stretched without bound.
const SLANT_LIMIT: f64 = 0.25;
/// Opacity = 1 - OPACITY_GAP · area^OPACITY_POWER: single pixels overlap from all views and must blend; what stands
/// for a large patch must cover it.
const OPACITY_GAP: f32 = 0.4;
const OPACITY_POWER: f32 = -0.35;

/// Where a cell lies in the scene.
pub(crate) struct Surface {
    /// z-depth at the anchor's pixel, scene units.
    pub(crate) depth: f64,
    /// The anchor's pixel position.
    pub(crate) pixel: DVec2,
    /// Unit normal in world axes, towards the camera.
    pub(crate) normal: DVec3,
}

/// Turns the normal towards the viewing ray until the slant limit holds; `ray` is the unit direction from the camera.
fn limit_slant(normal: DVec3, ray: DVec3) -> DVec3 {
    let facing = -normal.dot(ray);
    if facing >= SLANT_LIMIT {
        return normal;
    }
    let across = normal + ray * facing;
    match across.try_normalize() {
        Some(across) => across * (1.0 - SLANT_LIMIT * SLANT_LIMIT).sqrt() - ray * SLANT_LIMIT,
        None => -ray,
    }
}

/// Eigenvectors angle and eigenvalues (larger first) of the symmetric [a b; b c].
fn eigen(a: f64, b: f64, c: f64) -> (f64, [f64; 2]) {
    let (mean, half) = (0.5 * (a + c), 0.5 * (a - c));
    let radius = half.hypot(b);
    (0.5 * b.atan2(half), [mean + radius, (mean - radius).max(0.0)])
}

/// Appends the Gaussian of a cell: a disc on the surface's tangent plane whose picture has the cell's moments.
pub(crate) fn push(
    gaussians: &mut Gaussians,
    camera: &Camera,
    surface: &Surface,
    cell: &Cell,
    opacity_of_area: f32,
) {
    let lens = camera.intrinsics();
    let to_world = camera.rotation().transpose();
    let direction = to_world * lens.ray(surface.pixel);
    let normal = limit_slant(surface.normal, direction.normalize());

    // The point of the tangent plane at the cell's centre: the plane goes through the anchor.
    let anchor = direction * surface.depth;
    let centre = DVec2::new(f64::from(cell.centre[0]), f64::from(cell.centre[1]));
    let ray = to_world * lens.ray(centre);
    let depth = surface.depth * (normal.dot(direction) / normal.dot(ray)).clamp(0.8, 1.25);
    let _ = anchor;
    let mean = camera.position() + ray * depth;

    // How the tangent point moves with the pixel, in a basis of the plane.
    let facing = normal.dot(ray);
    let column = |axis: DVec3| (axis - ray * (normal.dot(axis) / facing)) * depth;
    let (du, dv) = (column(to_world.x_axis / lens.fx), column(to_world.y_axis / lens.fy));
    let first = du.normalize();
    let second = normal.cross(first);
    let (ux, vx, vy) = (du.length(), dv.dot(first), dv.dot(second));
    let [xx, xy, yy] = cell.covariance.map(|c| f64::from(c) * SPREAD);
    let a = ux * ux * xx + 2.0 * ux * vx * xy + vx * vx * yy;
    let b = vy * (ux * xy + vx * yy);
    let c = vy * vy * yy;
    let (angle, variances) = eigen(a, b, c);
    let major = first * angle.cos() + second * angle.sin();
    let minor = normal.cross(major);
    let rotation = DQuat::from_mat3(&DMat3::from_cols(major, minor, normal)).normalize();
    let floor = 1e-3 * variances[0].sqrt();
    let scales = [variances[0].sqrt(), variances[1].sqrt().max(floor)];
    let scales = [scales[0], scales[1], THICKNESS * scales[1]];

    gaussians.push(
        mean.as_vec3().to_array(),
        [rotation.w as f32, rotation.x as f32, rotation.y as f32, rotation.z as f32],
        scales.map(|s| (s as f32).max(f32::MIN_POSITIVE).ln()),
        logit(opacity_of_area),
        &dc_from_rgb(cell.colour),
    );
}

/// Opacity of a Gaussian that stands for `area` pixels.
pub(crate) fn opacity(area: f32) -> f32 {
    1.0 - OPACITY_GAP * area.max(1.0).powf(OPACITY_POWER)
}
