//! Filling of what could not be matched, from confident neighbours, along colours.

use glam::DVec2;
use rayon::prelude::*;

/// Luma difference (8-bit levels) across which the smoothness falls to 1/e.
const EDGE_LEVELS: f64 = 6.0;
/// Smoothness: larger values reach across larger holes.
const SMOOTHNESS: f64 = 4000.0;
/// Smoothed weight below which nothing reached a pixel.
const SMALLEST_WEIGHT: f64 = 1e-200;
/// Alternations of rows and columns.
const ROUNDS: u32 = 3;

/// Solves `(1 + Σ λ_ij) u_i - Σ λ_ij u_j = f_i` along one line in place, for two right-hand sides at once.
/// `links[i]` couples i and i + 1.
fn solve_line(values: &mut [DVec2], links: &[f64], scratch: &mut [f64]) {
    let n = values.len();
    let (mut before, mut factor, mut last) = (0.0, 0.0, DVec2::ZERO);
    for i in 0..n {
        let after = if i + 1 < n { links[i] } else { 0.0 };
        let diagonal = 1.0 + before + after - before * factor;
        factor = after / diagonal;
        scratch[i] = factor;
        last = (values[i] + before * last) / diagonal;
        values[i] = last;
        before = after;
    }
    for i in (0..n.saturating_sub(1)).rev() {
        last = values[i] + scratch[i] * last;
        values[i] = last;
    }
}

/// Edge-aware interpolation: the weighted mean of `values` that a smoother with weights by luma difference makes of
/// them (alternating one-dimensional solves, Min et al. 2014), numerator and denominator smoothed alike. Where no
/// weight reaches, the result is `None`. `luma` is whole 8-bit levels, give or take a common offset.
pub(crate) fn interpolate(values: &[f32], weights: &[f32], luma: &[f32], width: usize) -> Vec<Option<f32>> {
    let height = luma.len() / width;
    let similarity: [f64; 256] = std::array::from_fn(|levels| (-(levels as f64) / EDGE_LEVELS).exp());
    let similar = |a: usize, b: usize| similarity[((luma[a] - luma[b]).abs() as usize).min(255)];
    let weighted = |(&value, &weight)| DVec2::new(f64::from(value) * f64::from(weight), f64::from(weight));
    let mut field: Vec<DVec2> = values.iter().zip(weights).map(weighted).collect();
    let mut turned = vec![DVec2::ZERO; field.len()];
    let total = f64::from(4_u32.pow(ROUNDS) - 1);
    for round in 1..=ROUNDS {
        let lambda = 1.5 * f64::from(4_u32.pow(ROUNDS - round)) / total * SMOOTHNESS;
        field.par_chunks_mut(width).enumerate().for_each_init(
            || (vec![0.0; width - 1], vec![0.0; width]),
            |(links, scratch), (y, row)| {
                for (i, link) in (y * width..).zip(links.iter_mut()) {
                    *link = lambda * similar(i, i + 1);
                }
                solve_line(row, links, scratch);
            },
        );
        turned.par_chunks_mut(height).enumerate().for_each_init(
            || (vec![0.0; height - 1], vec![0.0; height]),
            |(links, scratch), (x, column)| {
                for (y, value) in column.iter_mut().enumerate() {
                    *value = field[y * width + x];
                }
                for (y, link) in links.iter_mut().enumerate() {
                    *link = lambda * similar(y * width + x, (y + 1) * width + x);
                }
                solve_line(column, links, scratch);
            },
        );
        field.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                *value = turned[x * height + y];
            }
        });
    }
    field.iter().map(|sum| (sum.y > SMALLEST_WEIGHT).then(|| (sum.x / sum.y) as f32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_takes_the_value_of_its_own_colour() {
        // Left half dark at 1, right half bright at 3; a hole in the middle of each.
        let (width, height) = (20, 10);
        let luma: Vec<f32> = (0..200).map(|i| if i % width < 10 { 20.0 } else { 200.0 }).collect();
        let values: Vec<f32> = (0..200).map(|i| if i % width < 10 { 1.0 } else { 3.0 }).collect();
        let weights: Vec<f32> = (0..width * height)
            .map(|i| f32::from(u8::from((i % width) % 10 < 3 || (i % width) % 10 > 7)))
            .collect();
        let filled = interpolate(&values, &weights, &luma, width);
        for (i, value) in filled.iter().enumerate() {
            assert!((value.unwrap() - values[i]).abs() < 0.02, "pixel {i}: {value:?}");
        }
    }

    #[test]
    fn nothing_to_go_by_is_none_and_one_value_reaches_everywhere() {
        let luma = vec![10.0; 12];
        assert!(interpolate(&[0.0; 12], &[0.0; 12], &luma, 4).iter().all(Option::is_none));
        let mut weights = [0.0; 12];
        weights[5] = 1.0;
        let filled = interpolate(&[2.5; 12], &weights, &luma, 4);
        assert!(filled.iter().all(|v| (v.unwrap() - 2.5).abs() < 1e-5));
        assert_eq!(interpolate(&[2.0], &[1.0], &[0.0], 1), [Some(2.0)]);
    }
}
