//! Ellipsoid views by their definition: every pixel looks at every ellipsoid.

use super::project::{Projected, Projection};
use crate::Profile;
use glam::{DVec2, DVec3};
use gs_scene::{Camera, Gaussians};
use gs_shaders::AMBIENT;

/// Which Gaussians an ellipsoid view draws, and how large.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Size of an ellipsoid, standard deviations.
    pub sigma: f64,
    /// Gaussians less opaque than this are not drawn.
    pub opacity_min: f64,
}

/// An ellipsoid view, `[height, width]` row-major each.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceEllipsoids {
    /// Colour over the background, `[height, width, 3]`.
    pub image: Vec<f64>,
    /// 1 where an ellipsoid is seen, else 0.
    pub alpha: Vec<f64>,
    /// z-depth of the front that is seen, scene units; 0 where there is none.
    pub depth: Vec<f64>,
    /// How much the numbers that decide what is seen would have to change, relative, for something else to be seen. Where it is
    /// small, f32 may decide otherwise; and near the rim a small change in the image is a large one in depth.
    pub margin: Vec<f64>,
}

/// The nearest front in every pixel between near and far; of equal ones that of the nearer centre, and then of the lower
/// index. The ellipsoids are those of the affine view in which blending sees the Gaussians, low-pass filter included: the
/// covariance of (u, v, z).
#[must_use]
pub fn render_ellipsoids(
    gaussians: &Gaussians,
    camera: &Camera,
    background: [f64; 3],
    profile: &Profile,
    solid: Solid,
) -> ReferenceEllipsoids {
    let mut ellipsoids: Vec<Ellipsoid> = (0..gaussians.len())
        .filter_map(|index| Projection::new(gaussians, index, camera, profile))
        .map(|projection| Ellipsoid::new(&projection, profile))
        .collect();
    ellipsoids.sort_by(|a, b| super::near_to_far(&a.projected, &b.projected));

    let pixels = camera.width() * camera.height();
    let mut out = ReferenceEllipsoids {
        image: Vec::with_capacity(pixels * 3),
        alpha: Vec::with_capacity(pixels),
        depth: Vec::with_capacity(pixels),
        margin: Vec::with_capacity(pixels),
    };
    for row in 0..camera.height() {
        for column in 0..camera.width() {
            let pixel = DVec2::new(column as f64, row as f64) + 0.5;
            let fronts: Vec<Front> =
                ellipsoids.iter().map(|ellipsoid| ellipsoid.front(pixel, solid.sigma)).collect();
            // Positive where a condition of being drawn holds, by how much, relative.
            let conditions = |place: usize| {
                let front = &fronts[place];
                [
                    ellipsoids[place].projected.opacity / solid.opacity_min - 1.0,
                    front.inside,
                    (front.depth - profile.near) / profile.near.abs().max(f64::MIN_POSITIVE),
                ]
            };
            let is_drawn = |place: &usize| conditions(*place).iter().all(|&by| by >= 0.0);
            // Of equal ones the first.
            let seen = (0..fronts.len())
                .filter(is_drawn)
                .min_by(|&a, &b| fronts[a].depth.total_cmp(&fronts[b].depth))
                .filter(|&place| fronts[place].depth < profile.far);
            let nearest = seen.map_or(profile.far, |place| fronts[place].depth);

            // What is seen would have to fail one condition, anything else to meet all that it fails.
            let distance = |place: usize| {
                let conditions = conditions(place).into_iter();
                if Some(place) == seen {
                    conditions.fold((profile.far - nearest) / nearest, f64::min)
                } else {
                    -conditions.fold((nearest - fronts[place].depth) / nearest, f64::min)
                }
            };
            let margin = (0..fronts.len()).map(distance).fold(f64::INFINITY, f64::min);
            out.image.extend(seen.map_or(background, |place| {
                let lit = ellipsoids[place].lit(&fronts[place], pixel, camera);
                ellipsoids[place].projected.rgb.map(|channel| channel * lit)
            }));
            out.alpha.push(if seen.is_some() { 1.0 } else { 0.0 });
            out.depth.push(if seen.is_some() { nearest } else { 0.0 });
            out.margin.push(margin);
        }
    }
    out
}

/// A vector of five independent standard normal numbers, of which (u, v, z) are linear functions: along the three axes of the
/// Gaussian, and along the two of the low-pass filter.
type Five = [f64; 5];

fn dot(a: Five, b: Five) -> f64 {
    (0..5).map(|i| a[i] * b[i]).sum()
}

/// `a` without its part along `unit`. Twice, because what rounding leaves of the first time is not orthogonal.
fn without(a: Five, unit: Five) -> Five {
    let once = |a: Five| {
        let along = dot(a, unit);
        std::array::from_fn(|i| a[i] - along * unit[i])
    };
    once(once(a))
}

fn unit(a: Five) -> (Five, f64) {
    let length = dot(a, a).sqrt();
    (a.map(|entry| entry / length), length)
}

/// The image of the ball |g| ≤ sigma under the linear functions u, v and z.
struct Ellipsoid {
    projected: Projected,
    /// Centre in camera axes.
    p: DVec3,
    /// Length of the function v, and of what u has that v has not.
    length_v: f64,
    length_u: f64,
    /// u along v's unit vector.
    u_on_v: f64,
    /// z along the unit vectors of those two, and the length of what z has that they have not.
    z_on_v: f64,
    z_on_u: f64,
    depth: f64,
}

/// Where a pixel's ray enters an ellipsoid; beyond the rim the front continues as what divides front from back.
struct Front {
    /// How far inside the rim the pixel lies, relative; negative outside.
    inside: f64,
    /// z-depth, scene units.
    depth: f64,
    /// Gradient in (u, v, z) of the quadratic form of which the ellipsoid is a level, of any length.
    normal: DVec3,
}

impl Ellipsoid {
    fn new(projection: &Projection, profile: &Profile) -> Self {
        let blur = profile.eps2d.sqrt();
        let five = |gaussian: DVec3, u: f64, v: f64| [gaussian.x, gaussian.y, gaussian.z, u, v];
        let u = five(projection.v[0], blur, 0.0);
        let (v, length_v) = unit(five(projection.v[1], 0.0, blur));
        let z = five(projection.m.row(2), 0.0, 0.0);
        let u_on_v = dot(u, v);
        let (u, length_u) = unit(without(u, v));
        let rest = without(without(z, v), u);
        Self {
            projected: projection.projected,
            p: projection.p,
            length_v,
            length_u,
            u_on_v,
            z_on_v: dot(z, v),
            z_on_u: dot(z, u),
            depth: dot(rest, rest).sqrt(),
        }
    }

    fn front(&self, pixel: DVec2, sigma: f64) -> Front {
        let d = pixel - self.projected.mean;
        // The shortest g that u and v take to the pixel: its parts along the two unit vectors.
        let on_v = d.y / self.length_v;
        let on_u = (d.x - self.u_on_v * on_v) / self.length_u;
        let square = on_v * on_v + on_u * on_u;
        // What is left of sigma points against the rest of z.
        let rise = (sigma * sigma - square).max(0.0).sqrt();
        // The linear function of (u, v) with these parts.
        let by_pixel = |on_v: f64, on_u: f64| {
            let by_u = on_u / self.length_u;
            DVec2::new(by_u, (on_v - self.u_on_v * by_u) / self.length_v)
        };
        let across = self.depth * by_pixel(on_v, on_u) + rise * by_pixel(self.z_on_v, self.z_on_u);
        Front {
            inside: 1.0 - square / (sigma * sigma),
            depth: self.p.z + on_v * self.z_on_v + on_u * self.z_on_u - self.depth * rise,
            normal: across.extend(-rise),
        }
    }

    /// Brightness under a lamp at the camera. A gradient by (u, v, z) becomes one by (x, y, z) by the transposed Jacobian of the
    /// projection at the centre.
    fn lit(&self, front: &Front, pixel: DVec2, camera: &Camera) -> f64 {
        let lens = camera.intrinsics();
        let (n, p) = (front.normal, self.p);
        let (by_x, by_y) = (n.x * lens.fx / p.z, n.y * lens.fy / p.z);
        let normal = DVec3::new(by_x, by_y, n.z - (by_x * p.x + by_y * p.y) / p.z);
        let cosine = normal.normalize_or_zero().dot(lens.ray(pixel).normalize()).abs();
        let ambient = f64::from(AMBIENT);
        ambient + (1.0 - ambient) * cosine
    }
}
