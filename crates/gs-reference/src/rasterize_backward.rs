//! Twin of the pass `rasterize_backward`: derivatives by the footprints.

use crate::alpha::alpha_at;
use crate::ewa::vector;
use glam::{DVec2, DVec3};
use gs_shaders::{Features, Frame, PAIR_GRADS, PIXEL_GRADS, Splat, TILE};

/// Derivatives by the footprints, `[pairs, 10]` by pair before sorting, zeros where no pixel was composited: with v the
/// derivative by the exponent -ln alpha the sums over the pixels of a tile of v, v e, v dy, v e e, v e dy, v dy dy; by colour
/// (3); by depth. `pixel_grads` are `[h, w, 6]`: by colour (3), by transmittance, by Σ w z, then the transmittance itself.
#[must_use]
pub fn rasterize_backward(
    frame: &Frame,
    splats: &[Splat],
    pair_splats: &[u32],
    pair_index: &[u32],
    ranges: &[[u32; 2]],
    ends: &[u32],
    pixel_grads: &[f32],
    features: Features,
) -> Vec<f32> {
    let mut sums = vec![[0.0; PAIR_GRADS]; pair_index.len()];
    for row in 0..frame.size[1] {
        for column in 0..frame.size[0] {
            let pixel = (row * frame.size[0] + column) as usize;
            let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
            let first = ranges[(row / TILE * frame.tiles[0] + column / TILE) as usize][0];
            let grads: Vec<f64> =
                pixel_grads[pixel * PIXEL_GRADS..][..PIXEL_GRADS].iter().map(|&g| f64::from(g)).collect();
            let grad_colour = DVec3::new(grads[0], grads[1], grads[2]);
            let grad_depth = if features.depth { grads[4] } else { 0.0 };
            let mut transmittance = grads[5];
            // The loss by what lies behind.
            let mut behind = transmittance * (grad_colour.dot(vector(frame.background)) + grads[3]);
            for place in (first..ends[pixel]).rev() {
                let pair = pair_index[place as usize] as usize;
                let splat = &splats[pair_splats[pair] as usize];
                let alpha = alpha_at(frame, splat, centre);
                if !alpha.drawn {
                    continue;
                }
                let rest = 1.0 - alpha.value;
                let before = transmittance / rest;
                let weight = before * alpha.value;
                let value = grad_colour.dot(vector(splat.rgb)) + grad_depth * f64::from(splat.depth);
                let v = if alpha.saturated { 0.0 } else { -alpha.value * (before * value - behind / rest) };
                let (e, dy) = (alpha.offset.x, alpha.offset.y);
                let terms = [
                    v,
                    v * e,
                    v * dy,
                    v * e * e,
                    v * e * dy,
                    v * dy * dy,
                    weight * grad_colour.x,
                    weight * grad_colour.y,
                    weight * grad_colour.z,
                    weight * grad_depth,
                ];
                for (sum, term) in sums[pair].iter_mut().zip(terms) {
                    *sum += term;
                }
                behind += weight * value;
                transmittance = before;
            }
        }
    }
    sums.into_iter().flatten().map(|sum| sum as f32).collect()
}
