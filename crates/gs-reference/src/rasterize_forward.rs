//! Twin of the pass `rasterize_forward`: near-to-far compositing.

use crate::alpha::alpha_at;
use crate::ewa::vector;
use glam::{DVec2, DVec3};
use gs_shaders::{Features, Frame, Splat, TILE};

/// What the pass writes for an image of `[h, w]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Pixels {
    /// `[h, w, 4]` colour over the background and transmittance; with depth `[h, w]` Σ w and `[h, w]` Σ w z after that.
    pub pixels: Vec<f32>,
    /// `[h, w]` place in the sorted pairs after the last one that was composited, 0 for none: what
    /// `rasterize_forward_train` adds.
    pub ends: Vec<u32>,
}

/// Composites the sorted pairs: `pair_index` is sorted by tile and within a tile near to far, `pair_splats` is not sorted,
/// `ranges` are those of the tiles.
#[must_use]
pub fn rasterize_forward(
    frame: &Frame,
    splats: &[Splat],
    pair_splats: &[u32],
    pair_index: &[u32],
    ranges: &[[u32; 2]],
    features: Features,
) -> Pixels {
    let (mut pixels, mut ends) = (Vec::new(), Vec::new());
    let (mut weights, mut depths) = (Vec::new(), Vec::new());
    for row in 0..frame.size[1] {
        for column in 0..frame.size[0] {
            let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
            let [first, last] = ranges[(row / TILE * frame.tiles[0] + column / TILE) as usize];
            let (mut colour, mut transmittance, mut end) = (DVec3::ZERO, 1.0, 0);
            let (mut sum_weight, mut sum_depth) = (0.0, 0.0);
            for place in first..last {
                let splat = &splats[pair_splats[pair_index[place as usize] as usize] as usize];
                let alpha = alpha_at(frame, splat, centre);
                if !alpha.drawn {
                    continue;
                }
                let next = transmittance * (1.0 - alpha.value);
                if next < f64::from(frame.transmittance_min) {
                    break;
                }
                let weight = transmittance * alpha.value;
                colour += weight * vector(splat.rgb);
                sum_weight += weight;
                sum_depth += weight * f64::from(splat.depth);
                transmittance = next;
                end = place + 1;
            }
            colour += transmittance * vector(frame.background);
            pixels.extend(colour.as_vec3().to_array());
            pixels.push(transmittance as f32);
            weights.push(sum_weight as f32);
            depths.push(sum_depth as f32);
            ends.push(end);
        }
    }
    if features.depth {
        pixels.extend(weights);
        pixels.extend(depths);
    }
    Pixels { pixels, ends }
}
