//! Twin of the pass `rasterize_ellipsoids`: the nearest ellipsoid in each pixel, lit from the camera.

use crate::alpha::alpha_at;
use crate::ewa::{focal_of, vector};
use crate::frame::join;
use glam::{DVec2, DVec3};
use gs_shaders::{AMBIENT, Frame, Splat, Surface, TILE};
use std::f64::consts::LN_2;

/// The picture: `[h, w, 4]` colour over the background, 1 where there is no ellipsoid else 0; `[h, w]` 1 where there is one else
/// 0; `[h, w]` z-depth of the front, 0 where there is none. The pairs are as in
/// [`rasterize_forward`](crate::rasterize_forward::rasterize_forward).
#[must_use]
pub fn rasterize_ellipsoids(
    frame: &Frame,
    splats: &[Splat],
    pair_splats: &[u32],
    pair_index: &[u32],
    ranges: &[[u32; 2]],
    surfaces: &[Surface],
) -> Vec<f32> {
    let (mut pixels, mut hits, mut depths) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..frame.size[1] {
        for column in 0..frame.size[0] {
            let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
            let [first, last] = ranges[(row / TILE * frame.tiles[0] + column / TILE) as usize];
            let mut nearest = f64::from(frame.far);
            let mut colour = vector(frame.background);
            for &pair in &pair_index[first as usize..last as usize] {
                let index = pair_splats[pair as usize] as usize;
                let Some((front, brightness)) = front_at(frame, &splats[index], &surfaces[index], centre)
                else {
                    continue;
                };
                if front > f64::from(frame.near) && front < nearest {
                    nearest = front;
                    colour = brightness * vector(splats[index].rgb);
                }
            }
            let hit = nearest < f64::from(frame.far);
            pixels.extend(colour.as_vec3().to_array());
            pixels.push(if hit { 0.0 } else { 1.0 });
            hits.push(if hit { 1.0 } else { 0.0 });
            depths.push(if hit { nearest as f32 } else { 0.0 });
        }
    }
    [pixels, hits, depths].concat()
}

/// z-depth and brightness of an ellipsoid's front in a pixel, if it reaches there.
fn front_at(frame: &Frame, splat: &Splat, surface: &Surface, centre: DVec2) -> Option<(f64, f64)> {
    let alpha = alpha_at(frame, splat, centre);
    if !alpha.drawn {
        return None;
    }
    let [a, g] = splat.falloff.map(|falloff| -2.0 * LN_2 * f64::from(falloff));
    let [slope_e, slope_y, sigma_z] = [surface.slope_e, surface.slope_y, surface.sigma_z].map(f64::from);
    let [shear] = join([splat.shear], [splat.shear_low]);
    let (e, dy) = (alpha.offset.x, alpha.offset.y);
    let sigma = f64::from(frame.ellipsoid_sigma);
    let rise = (sigma * sigma - a * e * e - g * dy * dy).max(0.0).sqrt();
    let front = f64::from(splat.depth) + slope_e * e + slope_y * dy - sigma_z * rise;
    // Slope of the front in the image, times `rise`, which is 0 at the rim.
    let by_e = slope_e * rise + sigma_z * a * e;
    let by_y = slope_y * rise + sigma_z * g * dy;
    Some((front, lit(frame, splat, centre, DVec2::new(by_e, by_y - shear * by_e), rise)))
}

/// Brightness of a front whose slope in the image, times `rise`, is `slope`, lit by a lamp at the camera.
fn lit(frame: &Frame, splat: &Splat, pixel: DVec2, slope: DVec2, rise: f64) -> f64 {
    let (focal, principal) = (focal_of(frame), DVec2::from(join(frame.centre, frame.centre_low)));
    let ray = ((pixel - principal) / focal).extend(1.0);
    // The gradient of z - front(x focal / z + …), taken at the centre: a normal in camera axes.
    let centre = (DVec2::from(join(splat.mean, splat.mean_low)) - principal) / focal;
    let across = slope * focal / f64::from(splat.depth);
    let normal = DVec3::new(-across.x, -across.y, rise + across.dot(centre));
    let lengths = normal.length() * ray.length();
    let cosine = if lengths > 0.0 { normal.dot(ray).abs() / lengths } else { 0.0 };
    let ambient = f64::from(AMBIENT);
    ambient + (1.0 - ambient) * cosine
}
