//! Augmentation by errors of depth. Stereo of rendered scenes is better than stereo of photographs. On photographs several views place one surface in
//! several layers, and a head that never saw such layers does not correct them.

use crate::Result;
use crate::draw::{Stream, bits, unit};
use gs_scene::DepthMap;
use sparsesplat::ViewGeometry;

/// How many times as wrong depth is where it is only filled in.
const FILLED: f64 = 3.0;
/// Largest relative error that is ever drawn: depth stays positive.
const LARGEST: f64 = 0.5;
/// Smallest and largest distance between two places of independent errors, pixels.
const CELL: [f64; 2] = [4.0, 64.0];

/// The geometry of a window with errors of depth that vary smoothly over each view, up to `strength` of the depth where
/// it is confirmed; each view draws how strong and how wide its own are. Half of the windows stay as they are.
pub(crate) fn disturbed(
    mut geometry: Vec<ViewGeometry>,
    strength: f64,
    seed: u64,
) -> Result<Vec<ViewGeometry>> {
    if strength == 0.0 || unit(seed, Stream::Disturbance, 0) < 0.5 {
        return Ok(geometry);
    }
    for (i, view) in geometry.iter_mut().enumerate() {
        let draw = |what| unit(seed, Stream::Disturbance, 1 + 3 * i + what);
        let strength = strength * draw(0).powi(2);
        let cell = CELL[0] * (CELL[1] / CELL[0]).powf(draw(1));
        let view_seed = bits(seed, Stream::Disturbance, 1 + 3 * i + 2);
        let (width, height) = (view.depth.width(), view.depth.height());
        let corners = (width as f64 / cell) as usize + 2;
        let corner = |x: usize, y: usize| 2.0 * unit(view_seed, Stream::Disturbance, y * corners + x) - 1.0;
        let mut depth = view.depth.data().to_vec();
        for (pixel, depth) in depth.iter_mut().enumerate() {
            let (x, y) = ((pixel % width) as f64 / cell, (pixel / width) as f64 / cell);
            let (left, top) = (x as usize, y as usize);
            let (right, below) = (x.fract(), y.fract());
            let row = |y| corner(left, y) * (1.0 - right) + corner(left + 1, y) * right;
            let error = strength * (row(top) * (1.0 - below) + row(top + 1) * below);
            let error = if view.is_confirmed(pixel) { error } else { FILLED * error };
            *depth *= (1.0 + error.clamp(-LARGEST, LARGEST)) as f32;
        }
        view.depth = DepthMap::new(width, height, depth)?;
    }
    Ok(geometry)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> Vec<ViewGeometry> {
        let view = |depth: f32| {
            let mut data = vec![depth; 30 * 20];
            data[7] = 0.0;
            let mut confidence = vec![1.0; 30 * 20];
            confidence[300..].fill(0.25);
            ViewGeometry {
                depth: DepthMap::new(30, 20, data).unwrap(),
                confidence,
                features: None,
                gaussians: None,
            }
        };
        vec![view(2.0), view(50.0)]
    }

    fn depths(geometry: &[ViewGeometry]) -> Vec<DepthMap> {
        geometry.iter().map(|view| view.depth.clone()).collect()
    }

    #[test]
    fn errors_are_bounded_and_larger_where_depth_is_filled_in() {
        let (mut changed, mut confirmed, mut filled) = (0, 0.0_f64, 0.0_f64);
        for seed in 0..200 {
            let after = disturbed(geometry(), 0.1, seed).unwrap();
            changed += usize::from(after[0].depth != geometry()[0].depth);
            for (before, after) in geometry().iter().zip(&after) {
                assert_eq!(after.depth.data()[7], 0.0, "no measurement stays none");
                let errors: Vec<f64> = before
                    .depth
                    .data()
                    .iter()
                    .zip(after.depth.data())
                    .map(|(before, after)| if *before == 0.0 { 0.0 } else { f64::from(after / before) - 1.0 })
                    .collect();
                let largest = |errors: &[f64]| errors.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
                confirmed = confirmed.max(largest(&errors[..300]));
                filled = filled.max(largest(&errors[300..]));
            }
            assert_eq!(depths(&after), depths(&disturbed(geometry(), 0.1, seed).unwrap()));
        }
        assert!((70..130).contains(&changed), "{changed}");
        assert!(confirmed > 0.04 && confirmed <= 0.1 + 1e-6, "{confirmed}");
        assert!(filled > 0.12 && filled <= 0.3 + 1e-6, "{filled}");
        assert_eq!(depths(&disturbed(geometry(), 0.0, 3).unwrap()), depths(&geometry()));
    }
}
