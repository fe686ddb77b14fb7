//! Gaussians as solid ellipsoids: no order and no blending, each pixel keeps the nearest front.

use super::footprint::{BLOCK, Columns, Footprint, View};
use super::vector3::Vector3;
use super::{Grid, TILE, sh};
use crate::StageSeconds;
use crate::settings::{ELLIPSOID_AMBIENT, INTERSECTIONS_MAX};
use crate::{ELLIPSOID_OPACITY_MIN, ELLIPSOID_SIGMA, Error, RenderSettings, RenderStats, Rendering, Result};
use cpu_kernels::lanes::{F32s, F64s};
use cpu_kernels::pulp::Scalar;
use cpu_kernels::{Isa, compiled_for};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, Gaussians, Image, sh_coefficients};
use rayon::prelude::*;
use std::time::Instant;

/// Gaussians per task.
const CHUNK: usize = 4096;
/// σ².
const SQUARE: f64 = (ELLIPSOID_SIGMA * ELLIPSOID_SIGMA) as f64;

/// A Gaussian in the affine view in which its footprint is an ellipse: the covariance of (u, v, z) has the filtered footprint as
/// that of (u, v). With e = du - shear dv and m = A e² + g dv², the front of the ellipsoid is at z-depth
/// z + slope[0] e + slope[1] dv - sigma_z √(σ² - m).
#[derive(Clone, Copy)]
struct Ellipsoid {
    /// Centre, pixels.
    mean: DVec2,
    /// (A, g), 1 / square pixels.
    conic: DVec2,
    shear: f64,
    z: f64,
    slope: DVec2,
    sigma_z: f64,
    /// Half width and half height, pixels.
    extent: DVec2,
    rgb: [f32; 3],
}

/// Renders a view.
pub(super) fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    isa: Isa,
) -> Result<Rendering> {
    let (width, height) = (camera.width(), camera.height());
    let grid = Grid::new(width, height);
    let mut seconds = StageSeconds::default();

    let start = Instant::now();
    let view = View::new(camera, settings);
    let sh_row = sh_coefficients(gaussians.sh_degree()) * 3;
    let chunks: Vec<(Vec<Ellipsoid>, usize)> = gaussians
        .geometry()
        .par_chunks(CHUNK * Gaussians::GEOMETRY)
        .zip(gaussians.sh().par_chunks(CHUNK * sh_row))
        .map(|(geometry, sh)| project(&view, gaussians.sh_degree(), geometry, sh))
        .collect();
    let rejected = chunks.iter().map(|(_, rejected)| rejected).sum();
    let ellipsoids = || chunks.iter().flat_map(|(ellipsoids, _)| ellipsoids);
    seconds.project = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let mut intersections = 0;
    let mut bands: Vec<Vec<&Ellipsoid>> = vec![Vec::new(); grid.rows];
    for ellipsoid in ellipsoids() {
        let [Some((left, right)), Some((top, bottom))] =
            [ellipsoid.pixels(0, width), ellipsoid.pixels(1, height)]
        else {
            continue;
        };
        let rows = top / TILE..bottom / TILE + 1;
        intersections += ((right / TILE + 1 - left / TILE) * rows.len()) as u64;
        if intersections <= INTERSECTIONS_MAX {
            bands[rows].iter_mut().for_each(|band| band.push(ellipsoid));
        }
    }
    if intersections > INTERSECTIONS_MAX {
        return Err(Error::TooManyIntersections { found: intersections, limit: INTERSECTIONS_MAX });
    }
    seconds.bin = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let mut image = Image::filled(width, height, settings.background)?;
    let mut depth = vec![0.0; width * height];
    image
        .data_mut()
        .par_chunks_mut(TILE * width * 3)
        .zip(depth.par_chunks_mut(TILE * width))
        .zip(bands)
        .enumerate()
        .for_each(|(row, ((image, depth), band))| {
            let size = [width, depth.len() / width];
            let seen = compiled_for!(isa, nearest(&band, &view, row * TILE, size));
            shade(&seen, &view, row * TILE, width, image, depth);
        });
    let alpha = depth.iter().map(|&depth| if depth > 0.0 { 1.0 } else { 0.0 }).collect();
    seconds.blend = start.elapsed().as_secs_f64();

    let stats = RenderStats { visible: ellipsoids().count(), rejected, intersections, seconds };
    Ok(Rendering { image, alpha, depth: settings.depth.then_some(depth), stats })
}

/// The ellipsoids of some Gaussians that are in the picture, and how many were rejected.
fn project(view: &View, degree: usize, geometry: &[f32], sh: &[f32]) -> (Vec<Ellipsoid>, usize) {
    let (mut ellipsoids, mut rejected) = (Vec::new(), 0);
    let mut columns = Columns::new(false);
    let sh_row = sh_coefficients(degree) * 3;
    for (rows, sh) in geometry.chunks(BLOCK * Gaussians::GEOMETRY).zip(sh.chunks(BLOCK * sh_row)) {
        for (place, row) in rows.chunks_exact(Gaussians::GEOMETRY).enumerate() {
            columns.set(place, row);
        }
        for (place, sh) in sh.chunks_exact(sh_row).enumerate() {
            if !columns.is_finite(Scalar, place).holds() {
                rejected += 1;
                continue;
            }
            let activations = columns.activate(Scalar, place);
            let footprint = Footprint::new(Scalar, view, &columns, &activations, place);
            let depth = footprint.mean.z.number();
            if !(depth > view.near && depth < view.far) {
                continue;
            }
            let largest_scale = footprint.given_scale.max_element().number();
            if footprint.norm.number() == 0.0 || largest_scale > f64::from(f32::MAX) {
                rejected += 1;
                continue;
            }
            let opacity = (footprint.opacity * footprint.compensation).number();
            if opacity < f64::from(ELLIPSOID_OPACITY_MIN) {
                continue;
            }
            let mut ellipsoid = Ellipsoid::new(view, &footprint);
            let outside = |axis: usize| {
                let [mean, extent] = [ellipsoid.mean, ellipsoid.extent].map(|v| F64s::splat(Scalar, v[axis]));
                view.is_outside(axis, mean, extent).holds()
            };
            if outside(0) || outside(1) {
                continue;
            }
            let offset = columns.mean(Scalar, place).vector() - view.position;
            let direction = offset.normalize().as_vec3().to_array();
            ellipsoid.rgb = colour(degree, direction, sh);
            if ellipsoid.is_finite() {
                ellipsoid.rgb = ellipsoid.rgb.map(|channel| channel.max(0.0));
                ellipsoids.push(ellipsoid);
            } else {
                rejected += 1;
            }
        }
    }
    (ellipsoids, rejected)
}

/// ½ + Σ Y · sh.
fn colour(degree: usize, direction: [f32; 3], sh: &[f32]) -> [f32; 3] {
    let direction = direction.map(|number| F32s::splat(Scalar, number));
    let basis = match degree {
        0 => sh::basis::<0, _>(direction),
        1 => sh::basis::<1, _>(direction),
        2 => sh::basis::<2, _>(direction),
        _ => sh::basis::<3, _>(direction),
    };
    let mut rgb = [0.5; 3];
    for (coefficients, basis) in sh.chunks_exact(3).zip(basis) {
        for (channel, coefficient) in rgb.iter_mut().zip(coefficients) {
            *channel += basis.number() * coefficient;
        }
    }
    rgb
}

impl Ellipsoid {
    fn new(view: &View, footprint: &Footprint<Scalar>) -> Self {
        let [a, b, c, det] = [footprint.a, footprint.b, footprint.c, footprint.det].map(F64s::number);
        let shear = b / c;
        let conic = DVec2::new(c / det, 1.0 / c);
        // Row of the camera's z axis in the Gaussian's axes and scales: a unit step along z.
        let z_axis = view.rotation.row(2);
        let [x_axis, y_axis, own_z_axis] = footprint.axes.map(Vector3::vector);
        let along_z = DVec3::new(z_axis.dot(x_axis), z_axis.dot(y_axis), z_axis.dot(own_z_axis))
            * footprint.scale.vector();
        let [u, v] = footprint.rows.map(Vector3::vector);
        let with = DVec2::new((u - v * shear).dot(along_z), v.dot(along_z));
        let slope = conic * with;
        // What is left of z once the pixel is given, along the Gaussian's axes and those of the low-pass filter: as a sum of
        // squares, because var z - slope · with cancels for flat Gaussians.
        let rest = along_z - (u - v * shear) * slope.x - v * slope.y;
        let filtered = DVec2::new(slope.x, slope.y - shear * slope.x);
        let variance = rest.length_squared() + view.eps2d * filtered.length_squared();
        Self {
            mean: DVec2::new(footprint.centre(view, 0).number(), footprint.centre(view, 1).number()),
            conic,
            shear,
            z: footprint.mean.z.number(),
            slope,
            sigma_z: variance.sqrt(),
            extent: DVec2::new(a.sqrt(), c.sqrt()) * f64::from(ELLIPSOID_SIGMA),
            rgb: [0.0; 3],
        }
    }

    fn is_finite(&self) -> bool {
        self.mean.is_finite()
            && self.conic.is_finite()
            && self.shear.is_finite()
            && self.slope.is_finite()
            && self.sigma_z.is_finite()
            && self.extent.is_finite()
            && self.rgb.iter().all(|channel| channel.is_finite())
    }

    /// First and last pixel along an axis whose centres its box may hold.
    fn pixels(&self, axis: usize, size: usize) -> Option<(usize, usize)> {
        let first = (self.mean[axis] - self.extent[axis] - 0.5).ceil().max(0.0);
        let last = (self.mean[axis] + self.extent[axis] - 0.5).floor().min((size - 1) as f64);
        (first <= last).then_some((first as usize, last as usize))
    }

    /// First and last pixel of a row, of which `dy` is the distance from the centre, whose centres the ellipse may hold, and what
    /// the row leaves of σ².
    #[inline(always)]
    fn span(&self, dy: f64, width: usize) -> (usize, usize, f64) {
        let rest = (SQUARE - self.conic.y * dy * dy).max(0.0);
        let (middle, half_width) = (self.mean.x + self.shear * dy, (rest / self.conic.x).sqrt());
        let first = (middle - half_width - 0.5).ceil().max(0.0);
        let last = (middle + half_width - 0.5).floor().min((width - 1) as f64);
        // Not empty if the end is beyond the first.
        (first as usize, (last + 1.0).max(0.0) as usize, rest)
    }

    /// √(σ² - m), given what a row leaves of σ²; 0 where rounding takes a pixel beyond the rim.
    #[inline(always)]
    fn rise(&self, e: f64, rest: f64) -> f64 {
        (rest - self.conic.x * e * e).max(0.0).sqrt()
    }

    /// Brightness of the front in a pixel, lit by a lamp at the camera.
    fn lit(&self, view: &View, pixel: DVec2) -> f64 {
        let (focal, principal) = (DVec2::from(view.focal), DVec2::from(view.centre));
        let ray = ((pixel - principal) / focal).extend(1.0);
        let d = pixel - self.mean;
        let place = DVec2::new(d.x - self.shear * d.y, d.y);
        let rise = self.rise(place.x, SQUARE - self.conic.y * d.y * d.y);
        // The front's slope in the image, times `rise`, which is 0 at the rim, where the slope is infinite.
        let by = self.slope * rise + self.sigma_z * self.conic * place;
        let slope = DVec2::new(by.x, by.y - self.shear * by.x);
        // Its normal, from image coordinates and depth to camera axes by the transposed Jacobian at the centre.
        let across = slope * focal / self.z;
        let normal = (-across).extend(rise + across.dot((self.mean - principal) / focal));
        let cosine = normal.dot(ray).abs() / (normal.length() * ray.length()).max(f64::MIN_POSITIVE);
        let ambient = f64::from(ELLIPSOID_AMBIENT);
        ambient + (1.0 - ambient) * cosine.min(1.0)
    }
}

/// The front that is seen in each pixel of some rows from `top` on: z-depth, and of which ellipsoid.
#[inline(always)]
fn nearest<'a>(
    band: &[&'a Ellipsoid],
    view: &View,
    top: usize,
    [width, rows]: [usize; 2],
) -> Vec<(f64, Option<&'a Ellipsoid>)> {
    // Depths of 0 mark pixels in which nothing is drawn.
    let near = view.near.max(f64::from(f32::MIN_POSITIVE));
    let mut seen = vec![(view.far, None::<&Ellipsoid>); width * rows];
    for &ellipsoid in band {
        let Some((first, last)) = ellipsoid.pixels(1, top + rows) else { continue };
        for row in first.max(top)..=last {
            let dy = row as f64 + 0.5 - ellipsoid.mean.y;
            let (first, end, rest) = ellipsoid.span(dy, width);
            // At e = 0.
            let (middle, along) =
                (ellipsoid.mean.x + ellipsoid.shear * dy, ellipsoid.z + ellipsoid.slope.y * dy);
            for column in first..end {
                let e = column as f64 + 0.5 - middle;
                let front = along + ellipsoid.slope.x * e - ellipsoid.sigma_z * ellipsoid.rise(e, rest);
                let (depth, other) = &mut seen[(row - top) * width + column];
                // Equal fronts: the nearer centre, then the first of the scene.
                let before =
                    front < *depth || front == *depth && other.is_some_and(|other| ellipsoid.z < other.z);
                if front > near && before {
                    (*depth, *other) = (front, Some(ellipsoid));
                }
            }
        }
    }
    seen
}

/// Writes what is seen in the rows from `top` on.
fn shade(
    seen: &[(f64, Option<&Ellipsoid>)],
    view: &View,
    top: usize,
    width: usize,
    image: &mut [f32],
    depth: &mut [f32],
) {
    for (index, (&(front, ellipsoid), depth)) in seen.iter().zip(depth).enumerate() {
        if let Some(ellipsoid) = ellipsoid {
            let pixel = DVec2::new((index % width) as f64, (top + index / width) as f64) + 0.5;
            let light = ellipsoid.lit(view, pixel) as f32;
            *depth = front as f32;
            for (channel, rgb) in image[index * 3..index * 3 + 3].iter_mut().zip(ellipsoid.rgb) {
                *channel = rgb * light;
            }
        }
    }
}
