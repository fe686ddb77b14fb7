//! Layer normalisation against f64, and its gradient against central differences.

use crate::{numbers, sets};
use cpu_kernels::LayerNorm;
use proptest::prelude::*;

fn normalised(row: &[f64], epsilon: f64) -> Vec<f64> {
    let count = row.len() as f64;
    let mean = row.iter().sum::<f64>() / count;
    let variance = row.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    row.iter().map(|v| (v - mean) / (variance + epsilon).sqrt()).collect()
}

fn wide(row: &[f32]) -> Vec<f64> {
    row.iter().map(|&v| f64::from(v)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn rows_agree_with_f64(
        columns in 1_usize..150, rows in 0_usize..5, offset in prop_oneof![Just(0.0_f32), Just(1e4), Just(-3e5)],
        size in prop_oneof![Just(1.0_f32), Just(1e-20), Just(1e6), Just(1e30), Just(3e38)], seed: u32,
    ) {
        let offset = if size > 1e6 { 0.0 } else { offset };
        let x: Vec<f32> = numbers(rows * columns, seed).iter().map(|v| v * size + offset).collect();
        let (weight, bias) = (numbers(columns, seed ^ 1), numbers(columns, seed ^ 2));
        let norm = LayerNorm { weight: &weight, bias: &bias, epsilon: 1e-5 };
        for isa in sets() {
            let mut out = vec![f32::NAN; x.len()];
            norm.apply(isa, &x, &mut out);
            for (row, found) in x.chunks_exact(columns).zip(out.chunks_exact(columns)) {
                for (c, v) in normalised(&wide(row), 1e-5).into_iter().enumerate() {
                    let expected = v * f64::from(weight[c]) + f64::from(bias[c]);
                    let error = (f64::from(found[c]) - expected).abs();
                    prop_assert!(error < 3e-6 * (1.0 + v.abs()), "{}: {} for {}", isa, found[c], expected);
                }
            }
        }
    }

    #[test]
    fn gradients_agree_with_central_differences(columns in 2_usize..140, rows in 1_usize..4, seed: u32) {
        let x = numbers(rows * columns, seed);
        let (weight, bias) = (numbers(columns, seed ^ 1), numbers(columns, seed ^ 2));
        let grad_out = numbers(x.len(), seed ^ 3);
        // The loss: the sum of outputs times their gradients.
        let loss = |x: &[f64], weight: &[f64], bias: &[f64]| -> f64 {
            let of_row = |(row, grad): (&[f64], &[f32])| -> f64 {
                let y = normalised(row, 1e-5);
                (0..columns).map(|c| (y[c] * weight[c] + bias[c]) * f64::from(grad[c])).sum()
            };
            x.chunks_exact(columns).zip(grad_out.chunks_exact(columns)).map(of_row).sum()
        };
        let [x64, weight64, bias64] = [wide(&x), wide(&weight), wide(&bias)];
        let difference = |part: usize, at: usize| {
            let moved = |step: f64| {
                let mut all = [x64.clone(), weight64.clone(), bias64.clone()];
                all[part][at] += step;
                loss(&all[0], &all[1], &all[2])
            };
            (moved(1e-5) - moved(-1e-5)) / 2e-5
        };
        for isa in sets() {
            let before = numbers(x.len(), seed ^ 4);
            let mut grad_x = before.clone();
            let (mut grad_weight, mut grad_bias) = (vec![0.5; columns], vec![-0.5; columns]);
            let norm = LayerNorm { weight: &weight, bias: &bias, epsilon: 1e-5 };
            norm.backward(isa, &x, &grad_out, &mut grad_x, (&mut grad_weight, &mut grad_bias));
            for at in [0, columns / 2, x.len() - 1] {
                let expected = f64::from(before[at]) + difference(0, at);
                // Two columns may nearly agree: the slope is then steep, up to 1 / sqrt(epsilon).
                prop_assert!((f64::from(grad_x[at]) - expected).abs() < 2e-4 * (1.0 + expected.abs()), "{}: x {}", isa, at);
            }
            for at in [0, columns - 1] {
                prop_assert!((f64::from(grad_weight[at]) - 0.5 - difference(1, at)).abs() < 1e-5, "{}: weight {}", isa, at);
                prop_assert!((f64::from(grad_bias[at]) + 0.5 - difference(2, at)).abs() < 1e-5, "{}: bias {}", isa, at);
            }
        }
    }
}

#[test]
fn the_largest_numbers_are_normalised() {
    let x = [f32::MAX, f32::MIN, f32::MAX, f32::MIN, f32::MAX, f32::MIN, f32::MAX, f32::MAX, f32::MIN];
    let norm = LayerNorm { weight: &[1.0; 9], bias: &[0.0; 9], epsilon: 1e-5 };
    for isa in sets() {
        let mut out = [0.0; 9];
        norm.apply(isa, &x, &mut out);
        for (found, expected) in out.iter().zip(normalised(&wide(&x), 1e-5)) {
            assert!((f64::from(*found) - expected).abs() < 1e-6, "{isa}: {found} for {expected}");
        }
    }
}
