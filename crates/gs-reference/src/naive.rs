use crate::{Profile, Projected, project};
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
    seen.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));

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
            let pixel = composite(&seen, column as f64 + 0.5, row as f64 + 0.5, profile);
            let alpha = 1.0 - pixel.transmittance;
            out.image.extend((0..3).map(|c| pixel.rgb[c] + pixel.transmittance * background[c]));
            out.alpha.push(alpha);
            out.transmittance.push(pixel.transmittance);
            out.depth_sum.push(pixel.depth_sum);
            out.depth.push(if pixel.contributors > 0 { pixel.depth_sum / alpha } else { 0.0 });
            out.contributors.push(pixel.contributors);
            out.last.push(pixel.last);
            out.margin.push(pixel.margin);
        }
    }
    out
}

struct Pixel {
    rgb: [f64; 3],
    transmittance: f64,
    depth_sum: f64,
    contributors: i32,
    last: i32,
    margin: f64,
}

fn composite(near_to_far: &[Projected], x: f64, y: f64, profile: &Profile) -> Pixel {
    let mut pixel = Pixel {
        rgb: [0.0; 3],
        transmittance: 1.0,
        depth_sum: 0.0,
        contributors: 0,
        last: -1,
        margin: f64::INFINITY,
    };
    for gaussian in near_to_far {
        let (dx, dy) = (x - gaussian.mean.x, y - gaussian.mean.y);
        let [a, b, c] = gaussian.conic;
        let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
        if sigma < 0.0 {
            continue;
        }
        let density = gaussian.opacity * (-sigma).exp();
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
        let weight = pixel.transmittance * alpha;
        for (sum, channel) in pixel.rgb.iter_mut().zip(gaussian.rgb) {
            *sum += weight * channel;
        }
        pixel.depth_sum += weight * gaussian.depth;
        pixel.transmittance = next;
        pixel.contributors += 1;
        pixel.last = gaussian.index as i32;
    }
    pixel
}
