//! A keyframe beside the map as it is seen from the same place.

use depth_backbone::ViewGeometry;
use rayon::prelude::*;

/// Opacity below which the map is thin: it does not show what is there.
pub(crate) const THIN: f32 = 0.5;
/// Depths are compared with those of the neighbourhood of a pixel, up to so many pixels away: at an edge both sides are right.
const REACH: usize = 2;
/// Mean absolute error of the colours of a window, 0..1, above which the map is wrong there.
const WRONG: f32 = 0.12;
/// Pixels of the window to either side.
const WINDOW: usize = 2;

/// How a pixel of a keyframe stands to the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pixel {
    /// The map is thin.
    Thin,
    /// Both see a surface at this depth.
    Agrees,
    /// The keyframe sees a surface before that of the map.
    Before,
    /// The keyframe sees through the surface of the map.
    Through,
    /// The keyframe does not know the depth for sure.
    Unknown,
}

/// Every pixel of a keyframe; depths agree within `tolerance`, relative.
pub(crate) fn classify(
    alpha: &[f32],
    rendered: &[f32],
    geometry: &ViewGeometry,
    tolerance: f32,
) -> Vec<Pixel> {
    let (width, depth) = (geometry.depth.width(), geometry.depth.data());
    let sure: Vec<f32> = depth
        .iter()
        .enumerate()
        .map(|(i, &depth)| if geometry.is_confirmed(i) { depth } else { 0.0 })
        .collect();
    let nearest = extreme(&sure, width, f32::min);
    let farthest = extreme(&sure, width, f32::max);
    let pixel = |i: usize| match () {
        () if alpha[i] < THIN => Pixel::Thin,
        () if sure[i] <= 0.0 => Pixel::Unknown,
        () if rendered[i] > farthest[i] * (1.0 + tolerance) => Pixel::Before,
        () if rendered[i] < nearest[i] * (1.0 - tolerance) => Pixel::Through,
        () => Pixel::Agrees,
    };
    (0..depth.len()).into_par_iter().with_min_len(1 << 12).map(pixel).collect()
}

/// The smallest or largest value above 0 within [`REACH`] of each pixel, in both directions; 0 where there is none.
fn extreme(values: &[f32], width: usize, choose: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let height = values.len() / width;
    let better = |best: f32, value: f32| match (best > 0.0, value > 0.0) {
        (true, true) => choose(best, value),
        (true, false) => best,
        _ => value,
    };
    let mut rows = vec![0.0; values.len()];
    rows.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            let span = x.saturating_sub(REACH)..(x + REACH + 1).min(width);
            *out = row[span].iter().copied().fold(0.0, better);
        }
    });
    let mut all = vec![0.0; values.len()];
    all.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for row in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
            for (out, &value) in out.iter_mut().zip(&rows[row * width..][..width]) {
                *out = better(*out, value);
            }
        }
    });
    all
}

/// Whether colours are wrong around each pixel; `error` is photograph less rendering, `[height, width, 3]`.
pub(crate) fn wrong_colours(error: &[f32], width: usize) -> Vec<bool> {
    let height = error.len() / 3 / width;
    let mut rows = vec![0.0_f32; width * height];
    rows.par_chunks_mut(width).zip(error.par_chunks(3 * width)).for_each(|(out, row)| {
        let of_pixel = |x: usize| (row[3 * x].abs() + row[3 * x + 1].abs() + row[3 * x + 2].abs()) / 3.0;
        for (x, out) in out.iter_mut().enumerate() {
            let span = x.saturating_sub(WINDOW)..(x + WINDOW + 1).min(width);
            let count = span.len() as f32;
            *out = span.map(of_pixel).sum::<f32>() / count;
        }
    });
    let mut wrong = vec![false; width * height];
    wrong.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let span = y.saturating_sub(WINDOW)..(y + WINDOW + 1).min(height);
        for (x, out) in out.iter_mut().enumerate() {
            let sum: f32 = span.clone().map(|row| rows[row * width + x]).sum();
            *out = sum > WRONG * span.len() as f32;
        }
    });
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_scene::DepthMap;

    fn geometry(depth: Vec<f32>) -> ViewGeometry {
        let confidence = depth.iter().map(|&d| if d > 0.0 { 1.0 } else { 0.0 }).collect();
        let depth = DepthMap::new(depth.len(), 1, depth).unwrap();
        ViewGeometry { depth, confidence, features: None, gaussians: None }
    }

    #[test]
    fn pixels_are_sorted_by_depth_and_opacity() {
        let measured = geometry(vec![2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
        let alpha = [0.2, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0];
        let rendered = [2.0, 2.02, 1.5, 3.0, 2.0, 7.0, 0.0];
        let found = classify(&alpha, &rendered, &measured, 0.03);
        use Pixel::{Agrees, Before, Thin, Through, Unknown};
        assert_eq!(found, [Thin, Agrees, Through, Before, Unknown, Unknown, Thin]);
    }

    #[test]
    fn at_an_edge_both_sides_are_right() {
        let measured = geometry(vec![1.0, 1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 5.0]);
        let rendered = [3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 5.0];
        let found = classify(&[1.0; 8], &rendered, &measured, 0.03);
        use Pixel::{Agrees, Before, Through};
        assert_eq!(found, [Before, Agrees, Agrees, Agrees, Agrees, Through, Through, Agrees]);
    }

    #[test]
    fn a_single_wrong_pixel_is_noise_and_a_patch_is_not() {
        let mut error = vec![0.0; 9 * 9 * 3];
        let paint = |error: &mut Vec<f32>, x: usize, y: usize| error[(y * 9 + x) * 3..][..3].fill(-0.9);
        paint(&mut error, 4, 4);
        assert!(!wrong_colours(&error, 9).contains(&true));
        for (x, y) in [(3, 4), (5, 4), (4, 3)] {
            paint(&mut error, x, y);
        }
        let wrong = wrong_colours(&error, 9);
        assert!(wrong[4 * 9 + 4] && !wrong[0] && !wrong[8 * 9 + 8]);
    }
}
