//! The renderer by its definition: no tiles, no bounds, no threads.

mod backward;
mod ellipsoids;
mod gradients;
mod project;
mod sh;

pub use backward::backward;
pub use ellipsoids::{ReferenceEllipsoids, Solid, render_ellipsoids};
pub use gradients::{PixelGradients, ReferenceGradients, Variable};
pub use project::{Projected, project};
pub use sh::basis;

use crate::Profile;
use gs_scene::{Camera, Gaussians};

/// What the reference renders, `[height, width]` row-major each.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Colour over the background, `[height, width, 3]`.
    pub image: Vec<f64>,
    /// 1 minus the transmittance.
    pub alpha: Vec<f64>,
    /// Transmittance that is left.
    pub transmittance: Vec<f64>,
    /// Σ w z, scene units.
    pub depth_sum: Vec<f64>,
    /// Σ w z / alpha, scene units; 0 where nothing is drawn.
    pub depth: Vec<f64>,
    /// Number of Gaussians drawn.
    pub contributors: Vec<i32>,
    /// Index of the last Gaussian drawn, -1 for none.
    pub last: Vec<i32>,
    /// Relative distance of the closest decision (skip, clamp, stop) from its threshold. Where it is small, f32 may
    /// decide otherwise.
    pub margin: Vec<f64>,
}

/// Renders by the definition: every pixel looks at every Gaussian between near and far, in the order of z-depth and then
/// of index.
#[must_use]
pub fn render(gaussians: &Gaussians, camera: &Camera, background: [f64; 3], profile: &Profile) -> Reference {
    let mut seen: Vec<Projected> =
        (0..gaussians.len()).filter_map(|index| project(gaussians, index, camera, profile)).collect();
    seen.sort_by(near_to_far);

    let pixels = camera.width() * camera.height();
    let mut out = Reference {
        image: Vec::with_capacity(pixels * 3),
        alpha: Vec::with_capacity(pixels),
        transmittance: Vec::with_capacity(pixels),
        depth_sum: Vec::with_capacity(pixels),
        depth: Vec::with_capacity(pixels),
        contributors: Vec::with_capacity(pixels),
        last: Vec::with_capacity(pixels),
        margin: Vec::with_capacity(pixels),
    };
    for row in 0..camera.height() {
        for column in 0..camera.width() {
            let pixel = composite(&seen, column, row, profile);
            let (mut rgb, mut depth_sum) = ([0.0; 3], 0.0);
            for layer in &pixel.layers {
                let (gaussian, weight) = (&seen[layer.place], layer.transmittance * layer.alpha);
                for (sum, channel) in rgb.iter_mut().zip(gaussian.rgb) {
                    *sum += weight * channel;
                }
                depth_sum += weight * gaussian.depth;
            }
            let alpha = 1.0 - pixel.transmittance;
            out.image.extend((0..3).map(|c| rgb[c] + pixel.transmittance * background[c]));
            out.alpha.push(alpha);
            out.transmittance.push(pixel.transmittance);
            out.depth_sum.push(depth_sum);
            out.depth.push(if pixel.layers.is_empty() { 0.0 } else { depth_sum / alpha });
            out.contributors.push(pixel.layers.len() as i32);
            out.last.push(pixel.layers.last().map_or(-1, |layer| seen[layer.place].index as i32));
            out.margin.push(pixel.margin);
        }
    }
    out
}

/// By z-depth, and where that is equal by index.
fn near_to_far(a: &Projected, b: &Projected) -> std::cmp::Ordering {
    a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index))
}

/// One Gaussian in one pixel.
struct Layer {
    /// Which Gaussian, by its place near to far.
    place: usize,
    /// Pixel centre minus the Gaussian's, pixels.
    offset: [f64; 2],
    /// exp(-σ).
    falloff: f64,
    /// Opacity in this pixel.
    alpha: f64,
    /// Transmittance in front of it.
    transmittance: f64,
}

struct Pixel {
    /// The Gaussians that are drawn, near to far.
    layers: Vec<Layer>,
    /// What is left behind them.
    transmittance: f64,
    /// As [`Reference::margin`].
    margin: f64,
}

/// Decides which Gaussians are drawn in a pixel, and how opaque they are.
fn composite(near_to_far: &[Projected], column: usize, row: usize, profile: &Profile) -> Pixel {
    let mut pixel = Pixel { layers: Vec::new(), transmittance: 1.0, margin: f64::INFINITY };
    for (place, gaussian) in near_to_far.iter().enumerate() {
        let (dx, dy) = (column as f64 + 0.5 - gaussian.mean.x, row as f64 + 0.5 - gaussian.mean.y);
        let [a, b, c] = gaussian.conic;
        let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
        if sigma < 0.0 {
            continue;
        }
        let falloff = (-sigma).exp();
        let density = gaussian.opacity * falloff;
        let alpha = density.min(profile.alpha_max);
        let mut decide = |value: f64, threshold: f64| {
            pixel.margin = pixel.margin.min((value / threshold - 1.0).abs());
        };
        decide(density, profile.alpha_min);
        if alpha < profile.alpha_min {
            continue;
        }
        decide(density, profile.alpha_max);
        let next = pixel.transmittance * (1.0 - alpha);
        decide(next, profile.transmittance_min);
        if next < profile.transmittance_min {
            break;
        }
        pixel.layers.push(Layer {
            place,
            offset: [dx, dy],
            falloff,
            alpha,
            transmittance: pixel.transmittance,
        });
        pixel.transmittance = next;
    }
    pixel
}
