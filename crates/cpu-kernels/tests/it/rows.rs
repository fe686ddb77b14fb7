//! Sums, products and mixtures of rows against f64.

use crate::{numbers, sets};
use cpu_kernels::{Rows, rows};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn rows_agree_with_the_definition(columns in 1_usize..90, count in 0_usize..6, seed: u32) {
        let (x, other) = (numbers(count * columns, seed), numbers(count * columns, seed ^ 1));
        let (row, factor) = (numbers(columns, seed ^ 2), numbers(columns, seed ^ 3));
        let close = |found: &[f32], expected: &dyn Fn(usize) -> f32| {
            found.iter().enumerate().all(|(i, v)| (v - expected(i)).abs() <= 1e-6 * (1.0 + v.abs()))
        };
        for isa in sets() {
            let done = |work: &dyn Fn(&mut [f32])| {
                let mut values = x.clone();
                work(&mut values);
                values
            };
            prop_assert!(close(&done(&|v| rows::add(isa, v, &other)), &|i| x[i] + other[i]));
            prop_assert!(close(&done(&|v| rows::add_and_clip(isa, v, &other)), &|i| (x[i] + other[i]).max(0.0)));
            prop_assert!(close(&done(&|v| rows::add_to_each(isa, v, &row)), &|i| x[i] + row[i % columns]));
            prop_assert!(close(&done(&|v| rows::multiply_each(isa, v, &row)), &|i| x[i] * row[i % columns]));
            let scaled = done(&|v| rows::scale_apart(isa, &x, &row, &factor, v));
            prop_assert!(close(&scaled, &|i| (x[i] - row[i % columns]) * factor[i % columns]));
            let mixed = done(&|v| rows::mix(isa, &x, &other, 0.3, v));
            prop_assert!(close(&mixed, &|i| 0.7 * x[i] + 0.3 * other[i]));
            let mut sums = row.clone();
            rows::add_sum(isa, Rows::new(&x, count, columns), &mut sums);
            let column = |c: usize| (0..count).map(move |r| r * columns + c);
            prop_assert!(close(&sums, &|c| row[c] + column(c).map(|i| x[i]).sum::<f32>()));
            let mut squares = row.clone();
            rows::add_squares(isa, Rows::new(&x, count, columns), &factor, &mut squares);
            prop_assert!(close(&squares, &|c| row[c] + column(c).map(|i| (x[i] - factor[c]).powi(2)).sum::<f32>()));
            let exact: f64 = row.iter().zip(&factor).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            prop_assert!((f64::from(rows::dot(isa, &row, &factor)) - exact).abs() < 2e-6 * columns as f64);
        }
    }

    #[test]
    fn exponentials_agree_with_the_definition(keys in 1_usize..90, labelled: bool, seed: u32) {
        let scores = numbers(keys, seed);
        let labels: Vec<f32> = (0..keys).map(|i| ((i + seed as usize % 3) % 3) as f32).collect();
        for isa in sets() {
            let mut found = scores.clone();
            let sum = rows::exponentials(isa, &mut found, 7.0, labelled.then_some((1.0, &labels)));
            let score = |i: usize| 7.0 * f64::from(scores[i]) - if labelled && labels[i] != 1.0 { 100.0 } else { 0.0 };
            let most = (0..keys).map(score).fold(f64::NEG_INFINITY, f64::max);
            for (i, v) in found.iter().enumerate() {
                prop_assert!((f64::from(*v) - (score(i) - most).exp()).abs() < 1e-5, "{}: {} of {}", isa, i, keys);
            }
            let expected: f64 = found.iter().map(|&v| f64::from(v)).sum();
            prop_assert!((f64::from(sum) - expected).abs() < 1e-5 * expected);
        }
    }
}

#[test]
fn huge_scores_do_not_overflow() {
    for isa in sets() {
        let mut row = [1e30, -1e30, 1e30, 0.0];
        assert_eq!(rows::exponentials(isa, &mut row, 1.0, None), 2.0, "{isa}");
        assert_eq!(row, [1.0, 0.0, 1.0, 0.0], "{isa}");
    }
}
