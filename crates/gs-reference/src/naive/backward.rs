//! Derivatives of the naive renderer, by hand.

use super::gradients::{PixelGradients, ReferenceGradients};
use super::project::{ProjectedGradients, Projection};
use super::{Projected, composite, near_to_far};
use crate::Profile;
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Gaussians};

/// The derivatives of a loss by everything that [`render`](super::render) depends on, given those by the pixels. They
/// belong to the decisions (skip, clamp, stop) that the rendering takes: no gradient passes a clamped opacity or a
/// colour at 0.
///
/// # Panics
/// If the pixel gradients do not have the size of the camera's picture.
#[must_use]
pub fn backward(
    gaussians: &Gaussians,
    camera: &Camera,
    background: [f64; 3],
    profile: &Profile,
    pixels: &PixelGradients,
) -> ReferenceGradients {
    let size = camera.width() * camera.height();
    let lengths = [pixels.image.len(), pixels.alpha.len(), pixels.depth_sum.len()];
    assert_eq!(lengths, [size * 3, size, size], "pixel gradients by image, alpha and depth_sum");
    let mut seen: Vec<Projection> =
        (0..gaussians.len()).filter_map(|index| Projection::new(gaussians, index, camera, profile)).collect();
    seen.sort_by(|a, b| near_to_far(&a.projected, &b.projected));
    let projected: Vec<Projected> = seen.iter().map(|projection| projection.projected).collect();

    let mut by_projected = vec![ProjectedGradients::default(); seen.len()];
    let mut by_background = [0.0; 3];
    for row in 0..camera.height() {
        for column in 0..camera.width() {
            let i = row * camera.width() + column;
            let by_pixel = [
                pixels.image[3 * i],
                pixels.image[3 * i + 1],
                pixels.image[3 * i + 2],
                pixels.alpha[i],
                pixels.depth_sum[i],
            ];
            let pixel = composite(&projected, column, row, profile);
            for (sum, by) in by_background.iter_mut().zip(by_pixel) {
                *sum += pixel.transmittance * by;
            }
            // What is seen behind a layer, as if nothing stood before it: colour, alpha and depth.
            let mut behind = [background[0], background[1], background[2], 0.0, 0.0];
            for layer in pixel.layers.iter().rev() {
                let (gaussian, by) = (&projected[layer.place], &mut by_projected[layer.place]);
                let [r, g, b] = gaussian.rgb;
                let values = [r, g, b, 1.0, gaussian.depth];
                let mut by_alpha = 0.0;
                for channel in 0..5 {
                    by_alpha += layer.transmittance * (values[channel] - behind[channel]) * by_pixel[channel];
                    behind[channel] = layer.alpha * values[channel] + (1.0 - layer.alpha) * behind[channel];
                }
                let weight = layer.transmittance * layer.alpha;
                for (sum, by_channel) in by.rgb.iter_mut().zip(by_pixel) {
                    *sum += weight * by_channel;
                }
                by.depth += weight * by_pixel[4];

                // alpha = min(alpha_max, opacity exp(-σ)), σ = (A dx² + C dy²) / 2 + B dx dy.
                let density = gaussian.opacity * layer.falloff;
                if density > profile.alpha_max {
                    continue;
                }
                by.opacity += layer.falloff * by_alpha;
                let by_sigma = -density * by_alpha;
                let ([dx, dy], [a, b, c]) = (layer.offset, gaussian.conic);
                for (sum, slope) in by.conic.iter_mut().zip([0.5 * dx * dx, dx * dy, 0.5 * dy * dy]) {
                    *sum += slope * by_sigma;
                }
                by.mean -= DVec2::new(a * dx + b * dy, b * dx + c * dy) * by_sigma;
            }
        }
    }
    collect(gaussians, camera, profile, &seen, &by_projected, by_background)
}

/// From the derivatives by the projected Gaussians to those by everything.
fn collect(
    gaussians: &Gaussians,
    camera: &Camera,
    profile: &Profile,
    seen: &[Projection],
    by_projected: &[ProjectedGradients],
    background: [f64; 3],
) -> ReferenceGradients {
    let n = gaussians.len();
    let k3 = gs_scene::sh_coefficients(gaussians.sh_degree()) * 3;
    let mut out = ReferenceGradients {
        geometry: vec![0.0; n * Gaussians::GEOMETRY],
        sh: vec![0.0; n * k3],
        background,
        world_to_camera: [0.0; 12],
        twist: [0.0; 6],
        means2d: vec![0.0; n * 2],
        conics: vec![0.0; n * 3],
        opacities: vec![0.0; n],
        rgb: vec![0.0; n * 3],
    };
    let (mut rotation, mut translation) = (DMat3::ZERO, DVec3::ZERO);
    for (projection, by) in seen.iter().zip(by_projected) {
        let i = projection.projected.index;
        let stored = projection.backward(by, camera, profile);
        out.geometry[i * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY].copy_from_slice(&stored.geometry);
        out.sh[i * k3..][..k3].copy_from_slice(&stored.sh);
        rotation += stored.rotation;
        translation += stored.translation;
        out.means2d[2 * i..][..2].copy_from_slice(&by.mean.to_array());
        out.conics[3 * i..][..3].copy_from_slice(&by.conic);
        out.opacities[i] = by.opacity;
        out.rgb[3 * i..][..3].copy_from_slice(&by.rgb);
    }
    for row in 0..3 {
        out.world_to_camera[4 * row..][..3].copy_from_slice(&rotation.row(row).to_array());
        out.world_to_camera[4 * row + 3] = translation[row];
    }
    // At T ← exp(ξ^) T the columns of R change by θ × R_k, the translation by ρ + θ × t.
    let turning: DVec3 = (0..3).map(|k| camera.rotation().col(k).cross(rotation.col(k))).sum();
    let turning = turning + camera.translation().cross(translation);
    out.twist = [translation.x, translation.y, translation.z, turning.x, turning.y, turning.z];
    out
}
