//! Gain and bias that convert the views to one exposure, from the content that they share.

use crate::ExposureGain;
use depth_backbone::ViewGeometry;
use glam::DVec2;
use gs_scene::View;
use rayon::prelude::*;

/// Every this-many-th pixel in both directions is compared.
const STRIDE: usize = 4;
/// Points that two views must have in common to be compared.
const ENOUGH: usize = 300;
/// Depths that differ by more than this (relative) are not the same point.
const SAME_POINT: f64 = 0.02;
/// Weight of "no change" against the mean square luma difference of a pair of views.
const PRIOR: f64 = 0.05;
/// Gains and biases are only applied if one of them moves a dark or a light grey by more than this (0..1).
const NOTICEABLE: f64 = 0.01;

/// Robust summary of the luma pairs of two views: both means, and how the second spreads against the first.
struct Overlap {
    views: [usize; 2],
    means: [f64; 2],
    deviations: [f64; 2],
}

/// Luma of both views at points that both see at the same depth.
fn common_points(
    views: &[View],
    geometry: &[ViewGeometry],
    luma: &[Vec<f32>],
    a: usize,
    b: usize,
) -> Vec<[f64; 2]> {
    let (from, to) = (views[a].camera(), views[b].camera());
    let mut pairs = Vec::new();
    for y in (STRIDE / 2..from.height()).step_by(STRIDE) {
        for x in (STRIDE / 2..from.width()).step_by(STRIDE) {
            let i = y * from.width() + x;
            let depth = f64::from(geometry[a].depth.data()[i]);
            if !geometry[a].is_confirmed(i) || depth <= 0.0 {
                continue;
            }
            let point = from.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), depth);
            let Some(pixel) = to.project(point).filter(|&pixel| to.contains(pixel)) else { continue };
            let j = pixel.y as usize * to.width() + pixel.x as usize;
            let seen = to.to_camera(point).z;
            let there = f64::from(geometry[b].depth.data()[j]);
            if (seen - there).abs() < SAME_POINT * seen && geometry[b].is_confirmed(j) {
                pairs.push([f64::from(luma[a][i]), f64::from(luma[b][j])]);
            }
        }
    }
    pairs
}

/// Means and deviations after dropping the tenth of the pairs that differs most from the median difference.
fn summarise(views: [usize; 2], mut pairs: Vec<[f64; 2]>) -> Option<Overlap> {
    // Saturated and black pixels say nothing of the exposure.
    pairs.retain(|pair| pair.iter().all(|&v| v > 0.02 && v < 0.98));
    if pairs.len() < ENOUGH {
        return None;
    }
    let middle = pairs.len() / 2;
    pairs.select_nth_unstable_by(middle, |p, q| (p[0] - p[1]).total_cmp(&(q[0] - q[1])));
    let median = pairs[middle][0] - pairs[middle][1];
    pairs.sort_by(|p, q| (p[0] - p[1] - median).abs().total_cmp(&(q[0] - q[1] - median).abs()));
    pairs.truncate(pairs.len() * 9 / 10);
    let n = pairs.len() as f64;
    let means = [0, 1].map(|side| pairs.iter().map(|p| p[side]).sum::<f64>() / n);
    let deviations =
        [0, 1].map(|side| (pairs.iter().map(|p| (p[side] - means[side]).powi(2)).sum::<f64>() / n).sqrt());
    Some(Overlap { views, means, deviations })
}

/// Least squares over all pairs: g_a (m ± d)_a + b_a = g_b (m ± d)_b + b_b, drawn weakly to g = 1, b = 0. The unknowns
/// are g and b of the first view, of the second …
fn solve(n_views: usize, overlaps: &[Overlap]) -> Vec<[f64; 2]> {
    let n = 2 * n_views;
    // Normal equations; the last column is the right-hand side.
    let mut rows = vec![vec![0.0; n + 1]; n];
    for (i, row) in rows.iter_mut().enumerate() {
        row[i] = PRIOR;
        row[n] = if i % 2 == 0 { PRIOR } else { 0.0 };
    }
    for overlap in overlaps {
        for sign in [-1.0, 1.0] {
            let [a, b] = overlap.views;
            let level = |side: usize| overlap.means[side] + sign * overlap.deviations[side];
            let equation = [(2 * a, level(0)), (2 * a + 1, 1.0), (2 * b, -level(1)), (2 * b + 1, -1.0)];
            for (i, p) in equation {
                for (j, q) in equation {
                    rows[i][j] += p * q;
                }
            }
        }
    }
    // Gauss-Jordan elimination; the prior makes the matrix positive definite, so no pivoting is needed.
    for i in 0..n {
        let pivot: Vec<f64> = rows[i].iter().map(|v| v / rows[i][i]).collect();
        for (k, row) in rows.iter_mut().enumerate() {
            let factor = row[i];
            for (value, pivot) in row.iter_mut().zip(&pivot) {
                *value = if k == i { *pivot } else { *value - factor * pivot };
            }
        }
    }
    rows.chunks_exact(2).map(|pair| [pair[0][n], pair[1][n]]).collect()
}

/// The views in a common exposure, and gain and bias that brought each there.
pub(crate) fn equalised(views: &[View], geometry: &[ViewGeometry]) -> (Vec<View>, Vec<ExposureGain>) {
    let exposure = equalise(views, geometry);
    let mut exposed = views.to_vec();
    exposed.iter_mut().zip(&exposure).for_each(|(view, exposure)| exposure.apply(view));
    (exposed, exposure)
}

/// Gain and bias per view, mean gain 1 and mean bias 0; exactly (1, 0) for all if the views do not noticeably differ.
fn equalise(views: &[View], geometry: &[ViewGeometry]) -> Vec<ExposureGain> {
    let luma: Vec<Vec<f32>> = views.par_iter().map(|view| view.image().luma()).collect();
    let pairs: Vec<[usize; 2]> = (0..views.len())
        .flat_map(|a| (0..views.len()).filter(move |&b| b != a).map(move |b| [a, b]))
        .collect();
    let overlaps: Vec<Overlap> = pairs
        .par_iter()
        .filter_map(|&[a, b]| summarise([a, b], common_points(views, geometry, &luma, a, b)))
        .collect();
    let mut solution = solve(views.len(), &overlaps);
    let mean_gain = solution.iter().map(|s| s[0]).sum::<f64>() / solution.len().max(1) as f64;
    let mean_bias = solution.iter().map(|s| s[1]).sum::<f64>() / solution.len().max(1) as f64;
    for [gain, bias] in &mut solution {
        *gain /= mean_gain;
        *bias = (*bias - mean_bias) / mean_gain;
    }
    let moves =
        |grey: f64| solution.iter().any(|[gain, bias]| (grey * gain + bias - grey).abs() > NOTICEABLE);
    let noticeable = moves(0.2) || moves(0.8);
    solution
        .into_iter()
        .map(|[gain, bias]| match noticeable {
            true => ExposureGain { gain: gain as f32, bias: bias as f32 },
            false => ExposureGain::NONE,
        })
        .collect()
}
