//! Normals by fitting planes to inverse depth.
//!
//! A plane m · X = 1 in camera axes, seen along the ray r = ((u - cx) / fx, (v - cy) / fy, 1) at X = z r, has
//! 1 / z = m · r: inverse depth is linear in the pixel position, with slopes m_x / fx and m_y / fy. A least-squares
//! fit of a + b du + c dv to inverse depth around a pixel therefore gives the plane without any bias from perspective:
//! m = (b fx, c fy, value of the fit at the principal point). m · r > 0, so that -m faces the camera.

use crate::anchors::pixel_centre;
use crate::{Error, Result};
use glam::DVec3;
use gs_scene::{Camera, DepthMap, Intrinsics};
use rayon::prelude::*;

/// How normals are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalFit {
    /// Width and height of the window, pixels; odd, 3 to 31.
    pub window: usize,
    /// Neighbours whose depth differs by more than this share of the pixel's own depth lie on another surface and take
    /// no part.
    pub max_relative_step: f32,
}

impl Default for NormalFit {
    /// 5×5 pixels, steps of at most 5 %.
    fn default() -> Self {
        Self { window: 5, max_relative_step: 0.05 }
    }
}

/// Fewer pixels than this say too little about a plane.
const MIN_SUPPORT: i64 = 4;

/// Unit normals in world axes towards the camera, one per pixel `[height, width]`, from the surface around each pixel. Where
/// too little surface is known (no depth, a thin or isolated thing), the normal points back along the viewing ray.
///
/// # Errors
/// If depth map and camera differ in size or a setting is out of range.
pub fn normals(depth: &DepthMap, camera: &Camera, fit: NormalFit) -> Result<Vec<[f32; 3]>> {
    check_size(depth, camera)?;
    let NormalFit { window, max_relative_step } = fit;
    if window.is_multiple_of(2) || !(3..=31).contains(&window) {
        return Err(Error::WindowSize { found: window });
    }
    if max_relative_step.is_nan() || max_relative_step <= 0.0 {
        return Err(Error::RelativeStep { found: max_relative_step });
    }
    let (width, intrinsics) = (depth.width(), camera.intrinsics());
    let to_world = camera.rotation().transpose();
    let inverse: Vec<f64> = depth.data().iter().map(|&z| 1.0 / f64::from(z)).collect();
    let mut out = vec![[0f32; 3]; depth.data().len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (x, normal) in out.iter_mut().enumerate() {
            let ray = intrinsics.ray(pixel_centre(y * width + x, width));
            let plane =
                fit_plane(depth, &inverse, (x, y), fit).map(|plane| plane.towards_camera(intrinsics, ray));
            let normal_in_camera = plane.unwrap_or(-ray);
            *normal = (to_world * normal_in_camera).normalize().as_vec3().to_array();
        }
    });
    Ok(out)
}

pub(crate) fn check_size(depth: &DepthMap, camera: &Camera) -> Result<()> {
    let (width, height) = (camera.width(), camera.height());
    if (depth.width(), depth.height()) != (width, height) {
        return Err(Error::SizeMismatch {
            width,
            height,
            found_width: depth.width(),
            found_height: depth.height(),
        });
    }
    Ok(())
}

/// Inverse depth around a pixel, 1 / scene units: `centre` + `dx` per pixel to the right + `dy` per pixel down.
struct InversePlane {
    centre: f64,
    dx: f64,
    dy: f64,
}

impl InversePlane {
    /// The plane's normal in camera axes towards the camera, any length; `ray` is that of the pixel.
    fn towards_camera(&self, intrinsics: &Intrinsics, ray: DVec3) -> DVec3 {
        let (mx, my) = (self.dx * intrinsics.fx, self.dy * intrinsics.fy);
        // The value at the principal point, where the ray is (0, 0, 1).
        let mz = self.centre - mx * ray.x - my * ray.y;
        -DVec3::new(mx, my, mz)
    }
}

/// Least squares over the neighbours on the same surface; `None` if these are too few or in one line. The moments
/// of the positions are integers, so that this is decided without rounding.
fn fit_plane(
    depth: &DepthMap,
    inverse: &[f64],
    (x, y): (usize, usize),
    fit: NormalFit,
) -> Option<InversePlane> {
    let (width, height) = (depth.width(), depth.height());
    let own = y * width + x;
    let z = depth.data()[own];
    if z <= 0.0 {
        return None;
    }
    let largest_step = fit.max_relative_step * z;
    let radius = fit.window / 2;
    let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0i64, 0, 0, 0, 0, 0);
    // Sums of the difference to the pixel's own inverse depth, times 1, dx and dy.
    let (mut d, mut dx_d, mut dy_d) = (0f64, 0f64, 0f64);
    for v in y.saturating_sub(radius)..(y + radius + 1).min(height) {
        for u in x.saturating_sub(radius)..(x + radius + 1).min(width) {
            let other = v * width + u;
            let other_z = depth.data()[other];
            if other_z <= 0.0 || (other_z - z).abs() > largest_step {
                continue;
            }
            let (dx, dy) = (u as i64 - x as i64, v as i64 - y as i64);
            n += 1;
            sx += dx;
            sy += dy;
            sxx += dx * dx;
            sxy += dx * dy;
            syy += dy * dy;
            let difference = inverse[other] - inverse[own];
            d += difference;
            dx_d += dx as f64 * difference;
            dy_d += dy as f64 * difference;
        }
    }
    // n² times the covariances.
    let (cxx, cxy, cyy) = (n * sxx - sx * sx, n * sxy - sx * sy, n * syy - sy * sy);
    let determinant = cxx * cyy - cxy * cxy;
    if n < MIN_SUPPORT || determinant == 0 {
        return None;
    }
    let [n, sx, sy, cxx, cxy, cyy, determinant] = [n, sx, sy, cxx, cxy, cyy, determinant].map(|i| i as f64);
    let (cx, cy) = (n * dx_d - sx * d, n * dy_d - sy * d);
    let dx = (cyy * cx - cxy * cy) / determinant;
    let dy = (cxx * cy - cxy * cx) / determinant;
    let centre = inverse[own] + (d - dx * sx - dy * sy) / n;
    // A fit that puts the surface behind the camera is none.
    (centre > 0.0).then_some(InversePlane { centre, dx, dy })
}
