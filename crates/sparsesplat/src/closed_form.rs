//! The closed-form head: every attribute of a Gaussian by formula, from the patch that its anchor stands for.
//!
//! Shape: the second moments of the cell, lifted to the tangent plane of the surface, times a factor. The factor falls with the density of anchors in
//! space: if other views have anchors on the same surface, each Gaussian needs to cover less. A Gaussian that covers its cell alone (factor 3.6: a standard
//! deviation of 0.55 instead of 0.29 cell widths) lost 1.8 dB at 40k by blur. If no other view confirms the depth, there is no sharpness to keep, and the
//! Gaussian is wider.

use crate::cells::Cell;
use glam::{DMat3, DQuat, DVec2, DVec3};
use gs_scene::{Camera, Gaussians, dc_from_rgb, logit};

/// Variance of the Gaussian over variance of its cell on a surface that another view confirms, where no other view has
/// anchors.
const SPREAD: f64 = 1.7;
/// The same where no other view confirms the surface.
const UNCONFIRMED_SPREAD: f64 = 2.2;
/// The same for a voxel, which has its surface to itself: it holds what all views have there. On two scenes at 40k the
/// spread of the others loses 1.3 dB, 3.5 loses 0.2.
const VOXEL_SPREAD: f64 = 2.6;
/// Smallest share of the cell's area that an anchor among many is taken to stand for.
const SMALLEST_SHARE: f64 = 0.25;
/// Thickness of the disc over the smaller of its two standard deviations.
const THICKNESS: f64 = 0.15;
/// Smallest ratio of a disc's two standard deviations.
const SMALLEST_ASPECT: f64 = 1e-3;
/// Cosine between normal and viewing ray below which a disc is turned towards the camera: a grazing one would be
/// stretched without bound.
const SLANT_LIMIT: f64 = 0.35;
/// Factor by which the depth of a cell's centre may differ from its anchor's: the plane of a large, slanted cell says
/// little about its far side.
const FARTHEST_SHIFT: f64 = 1.25;
/// Opacity = 1 - OPACITY_GAP · area^OPACITY_POWER: single pixels overlap from all views and must blend; what stands
/// for a large patch must cover it.
const OPACITY_GAP: f32 = 0.4;
const OPACITY_POWER: f32 = -0.35;

/// Where an anchor lies, and how close its neighbours are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    /// The anchor's pixel position.
    pub(crate) pixel: DVec2,
    /// z-depth there, scene units.
    pub(crate) depth: f64,
    /// Unit normal in world axes, towards the camera.
    pub(crate) normal: DVec3,
    /// Surface per anchor, scene units²: π r² / K, r the distance of the K-th neighbour; `None` without neighbours.
    pub(crate) area_per_anchor: Option<f64>,
    /// Whether the depth is measured, not filled in.
    pub(crate) confirmed: bool,
    /// Whether the anchor is a voxel, not a pixel.
    pub(crate) voxel: bool,
}

/// Turns the normal towards the viewing ray until the slant limit holds; `ray` is the unit direction from the camera.
fn limit_slant(normal: DVec3, ray: DVec3) -> DVec3 {
    let facing = -normal.dot(ray);
    if facing >= SLANT_LIMIT {
        return normal;
    }
    match (normal + ray * facing).try_normalize() {
        Some(across) => across * (1.0 - SLANT_LIMIT * SLANT_LIMIT).sqrt() - ray * SLANT_LIMIT,
        None => -ray,
    }
}

/// Angle of the first eigenvector and the eigenvalues, larger first, of the symmetric [a b; b c].
fn eigen(a: f64, b: f64, c: f64) -> (f64, [f64; 2]) {
    let (mean, half) = (0.5 * (a + c), 0.5 * (a - c));
    let radius = half.hypot(b);
    (0.5 * b.atan2(half), [mean + radius, (mean - radius).max(0.0)])
}

/// Opacity of a Gaussian that stands for `area` pixels.
fn opacity(area: f32) -> f32 {
    1.0 - OPACITY_GAP * area.max(1.0).powf(OPACITY_POWER)
}

/// Appends the Gaussian of a cell to a set of SH degree 0: a disc on the surface's tangent plane.
pub(crate) fn push(gaussians: &mut Gaussians, camera: &Camera, surface: &Surface, cell: &Cell) {
    let lens = camera.intrinsics();
    let to_world = camera.rotation().transpose();
    let direction = to_world * lens.ray(surface.pixel);
    let normal = limit_slant(surface.normal, direction.normalize());

    // The plane goes through the anchor, the disc sits where it meets the ray of the cell's centre.
    let centre = DVec2::from(cell.centre.map(f64::from));
    let ray = to_world * lens.ray(centre);
    let facing = normal.dot(ray);
    let depth = surface.depth * (normal.dot(direction) / facing).clamp(1.0 / FARTHEST_SHIFT, FARTHEST_SHIFT);
    let mean = camera.position() + ray * depth;

    // How the point on the plane moves with the pixel, in an orthonormal basis of the plane.
    let per_pixel = |axis: DVec3, focal: f64| (axis - ray * (normal.dot(axis) / facing)) * (depth / focal);
    let (right, down) = (per_pixel(to_world.x_axis, lens.fx), per_pixel(to_world.y_axis, lens.fy));
    let first = right.normalize();
    let second = normal.cross(first);
    let (ux, vx, vy) = (right.length(), down.dot(first), down.dot(second));

    let cell_area = f64::from(cell.area) * (ux * vy).abs();
    let share = surface.area_per_anchor.map_or(1.0, |area| (area / cell_area).clamp(SMALLEST_SHARE, 1.0));
    let spread = match surface {
        Surface { voxel: true, .. } => VOXEL_SPREAD,
        Surface { confirmed: true, .. } => SPREAD * share.sqrt(),
        _ => UNCONFIRMED_SPREAD,
    };
    let [xx, xy, yy] = cell.covariance.map(|c| f64::from(c) * spread);
    let (angle, variances) =
        eigen(ux * ux * xx + 2.0 * ux * vx * xy + vx * vx * yy, vy * (ux * xy + vx * yy), vy * vy * yy);
    let major = first * angle.cos() + second * angle.sin();
    let minor = normal.cross(major);
    let rotation = DQuat::from_mat3(&DMat3::from_cols(major, minor, normal)).normalize();
    let wide = variances[0].sqrt();
    let narrow = variances[1].sqrt().max(SMALLEST_ASPECT * wide);

    gaussians.push(
        mean.as_vec3().to_array(),
        [rotation.w as f32, rotation.x as f32, rotation.y as f32, rotation.z as f32],
        [wide, narrow, THICKNESS * narrow].map(|s| (s as f32).max(f32::MIN_POSITIVE).ln()),
        logit(opacity(cell.area)),
        &dc_from_rgb(cell.colour),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_scene::{Intrinsics, LOG_SCALE, MEAN, QUATERNION};
    use proptest::prelude::*;

    const LENS: Intrinsics = Intrinsics { fx: 210.0, fy: 190.0, cx: 80.0, cy: 60.0, width: 160, height: 120 };

    fn covariance_in_picture(gaussians: &Gaussians, camera: &Camera) -> [f64; 3] {
        let row = gaussians.geometry();
        let mean = DVec3::new(f64::from(row[0]), f64::from(row[1]), f64::from(row[2]));
        let q = &row[QUATERNION];
        let rotation = DMat3::from_quat(
            DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into()).normalize(),
        );
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (axis, log_scale) in row[LOG_SCALE].iter().enumerate() {
            // The picture of each axis by differences, small against the disc's depth.
            let step = rotation.col(axis) * f64::from(log_scale.exp()) * 1e-3;
            let moved = (camera.project(mean + step).unwrap() - camera.project(mean - step).unwrap()) / 2e-3;
            xx += moved.x * moved.x;
            xy += moved.x * moved.y;
            yy += moved.y * moved.y;
        }
        [xx, xy, yy]
    }

    proptest! {
        #[test]
        fn the_picture_of_the_disc_has_the_cells_moments(
            (x, y) in (10.0f64..150.0, 10.0f64..110.0), depth in 0.5f64..20.0,
            tilt in prop::array::uniform2(-0.6f64..0.6), turn in -3.0f64..3.0, offset in -1e3f64..1e3,
            (long, short, angle) in (1.0f64..6.0, 0.5f64..1.0, 0.0f64..3.0),
        ) {
            let camera = Camera::new(LENS, DMat3::from_rotation_y(turn), DVec3::splat(offset)).unwrap();
            let towards = camera.rotation().transpose() * DVec3::new(tilt[0], tilt[1], -1.0).normalize();
            let (c, s) = (angle.cos(), angle.sin());
            let moments = [
                long * c * c + short * s * s, (long - short) * c * s, long * s * s + short * c * c,
            ];
            let cell = Cell {
                area: 20.0, centre: [x as f32, y as f32], covariance: moments.map(|m| m as f32), colour: [0.2; 3],
                ..Cell::default()
            };
            let surface =
                Surface { pixel: DVec2::new(x, y), depth, normal: towards, area_per_anchor: None, confirmed: true, voxel: false };
            prop_assume!(-towards.dot((camera.rotation().transpose() * LENS.ray(surface.pixel)).normalize()) > 0.4);
            let mut gaussians = Gaussians::empty(0).unwrap();
            push(&mut gaussians, &camera, &surface, &cell);
            for (found, expected) in covariance_in_picture(&gaussians, &camera).iter().zip(moments) {
                // The disc's thickness adds at most its own share.
                prop_assert!((found - SPREAD * expected).abs() < 0.12 * SPREAD * long, "{found} {expected}");
            }
        }
    }

    #[test]
    fn dense_neighbours_narrow_the_disc_within_limits() {
        let camera = Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let cell = Cell { area: 9.0, centre: [80.0, 60.0], covariance: [0.75, 0.0, 0.75], ..Cell::default() };
        let width = |area_per_anchor| {
            let surface = Surface {
                pixel: DVec2::new(80.0, 60.0),
                depth: 2.0,
                normal: DVec3::NEG_Z,
                area_per_anchor,
                confirmed: true,
                voxel: false,
            };
            let mut gaussians = Gaussians::empty(0).unwrap();
            push(&mut gaussians, &camera, &surface, &cell);
            assert!(gaussians.geometry()[MEAN].iter().all(|v| v.is_finite()));
            gaussians.geometry()[LOG_SCALE.start].exp()
        };
        let alone = width(None);
        assert_eq!(width(Some(f64::INFINITY)), alone);
        assert!((width(Some(0.0)) / alone - SMALLEST_SHARE.powf(0.25) as f32).abs() < 1e-3);
        let half = width(Some(0.5 * 9.0 * 4.0 / (210.0 * 190.0)));
        assert!((half / alone - 0.5_f32.powf(0.25)).abs() < 1e-3);
    }

    #[test]
    fn grazing_surfaces_and_normals_along_the_ray_stay_bounded() {
        let camera = Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let cell = Cell { area: 9.0, centre: [83.0, 62.0], covariance: [0.75, 0.0, 0.75], ..Cell::default() };
        for normal in [DVec3::X, DVec3::Z, DVec3::new(0.0, 1.0, -1e-9).normalize(), DVec3::NEG_Z] {
            let surface = Surface {
                pixel: DVec2::new(80.0, 60.0),
                depth: 2.0,
                normal,
                area_per_anchor: None,
                confirmed: true,
                voxel: false,
            };
            let mut gaussians = Gaussians::empty(0).unwrap();
            push(&mut gaussians, &camera, &surface, &cell);
            assert!(gaussians.geometry().iter().all(|v| v.is_finite()), "{normal}");
            let depth = f64::from(gaussians.geometry()[2]);
            assert!((1.6..=2.5).contains(&depth), "{normal}: {depth}");
            assert!(gaussians.geometry()[LOG_SCALE.start].exp() < 0.1);
        }
    }
}
