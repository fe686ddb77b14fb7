//! Products against f64: shapes that fill no tile, strides, nothing at all.

use crate::{numbers, sets};
use cpu_kernels::{Packed, Rows, multiply, multiply_transposed, multiply_with_bias, panel_columns};
use proptest::prelude::*;

/// Lengths that fit tiles, that miss them by one, primes, 1 and 0.
fn length(most: usize) -> impl Strategy<Value = usize> {
    let special: Vec<usize> =
        [0, 1, 2, 5, 6, 7, 8, 13, 15, 16, 17, 31, 32, 33, 48, 64, 97, 128, 383, 384, 385, 769]
            .into_iter()
            .filter(|&n| n <= most)
            .collect();
    prop_oneof![proptest::sample::select(special), 0..most + 1]
}

/// Sum of a(k) b(k) and of the terms' sizes.
fn exact(terms: impl Iterator<Item = (f32, f32)>) -> (f64, f64) {
    terms.fold((0.0, 0.0), |(sum, size), (a, b)| {
        let term = f64::from(a) * f64::from(b);
        (sum + term, size + term.abs())
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn products_agree_with_f64(
        count in length(60), depth in length(800), columns in length(140), gap in 0_usize..4, add: bool, with_bias: bool,
        seed: u32,
    ) {
        let width = depth + gap;
        let a = numbers(count * width, seed);
        // The last row is followed by nothing.
        let a = &a[..a.len().saturating_sub(gap)];
        let b = numbers(columns * depth, seed ^ 77_777);
        let bias = if with_bias { numbers(columns, seed ^ 9) } else { vec![0.0; columns] };
        let stride = columns + gap;
        for isa in sets() {
            let packed = Packed::transposed(isa, Rows::new(&b, columns, depth));
            prop_assert_eq!((packed.depth(), packed.columns(), packed.isa()), (depth, columns, isa));
            let before = numbers(count * stride, seed ^ 5);
            let mut c = before.clone();
            let rows = Rows::strided(a, count, depth, width);
            if with_bias {
                multiply_with_bias(rows, &packed, &bias, &mut c, stride, add);
            } else {
                multiply(rows, &packed, &mut c, stride, add);
            }
            for (place, &found) in c.iter().enumerate() {
                let (i, j) = (place / stride.max(1), place % stride.max(1));
                if j >= columns {
                    prop_assert_eq!(found, before[place], "between the rows");
                    continue;
                }
                let (sum, size) = exact((0..depth).map(|k| (a[i * width + k], b[j * depth + k])));
                let start = f64::from(bias[j]) + if add { f64::from(before[place]) } else { 0.0 };
                let size = size + f64::from(bias[j].abs());
                let error = (f64::from(found) - sum - start).abs();
                prop_assert!(error <= 1e-5 * (size + start.abs()) + 1e-30, "{} ({}, {}): {:e} of {}", isa, i, j, error, size);
            }
        }
    }

    #[test]
    fn sums_over_rows_agree_with_f64(
        count in length(97), width_a in length(70), width_b in length(70), gap in 0_usize..3, seed: u32,
    ) {
        let (a, b) = (numbers(count * (width_a + gap), seed), numbers(count * width_b, seed ^ 99));
        for isa in sets() {
            let stride = width_b + gap;
            let before = numbers(width_a * stride, seed ^ 3);
            let mut c = before.clone();
            let rows = Rows::strided(&a, count, width_a, width_a + gap);
            multiply_transposed(isa, rows, Rows::new(&b, count, width_b), &mut c, stride);
            for (place, &found) in c.iter().enumerate() {
                let (i, j) = (place / stride.max(1), place % stride.max(1));
                if j >= width_b {
                    prop_assert_eq!(found, before[place], "between the rows");
                    continue;
                }
                let (sum, size) = exact((0..count).map(|k| (a[k * (width_a + gap) + i], b[k * width_b + j])));
                let expected = f64::from(before[place]) + sum;
                prop_assert!((f64::from(found) - expected).abs() <= 1e-5 * (size + 1.0), "{} ({}, {})", isa, i, j);
            }
        }
    }

    #[test]
    fn a_panel_is_the_product_filled_up_with_zeros(
        count in length(40), depth in length(400), columns in 1_usize..70, seed: u32,
    ) {
        let (a, b) = (numbers(count * depth, seed), numbers(columns * depth, seed ^ 1));
        for isa in sets() {
            let packed = Packed::rows(isa, Rows::new(&b, depth, columns));
            let mut whole = vec![f32::NAN; count * columns];
            multiply(Rows::new(&a, count, depth), &packed, &mut whole, columns, false);
            let width = panel_columns(isa);
            for p in 0..packed.panel_count() {
                let mut panel = vec![f32::NAN; count * width];
                packed.multiply_panel(p, Rows::new(&a, count, depth), &mut panel, width);
                for (i, row) in panel.chunks_exact(width).enumerate() {
                    for (j, &found) in row.iter().enumerate() {
                        let column = p * width + j;
                        let expected = if column < columns { whole[i * columns + column] } else { 0.0 };
                        prop_assert_eq!(found, expected);
                    }
                }
            }
        }
    }
}

#[test]
fn what_is_not_a_number_stays_in_its_row_and_column() {
    for isa in sets() {
        let mut a = numbers(7 * 20, 1);
        a[3 * 20 + 4] = f32::NAN;
        let b = Packed::rows(isa, Rows::new(&[1.0; 20 * 17], 20, 17));
        let mut c = vec![0.0; 7 * 17];
        multiply(Rows::new(&a, 7, 20), &b, &mut c, 17, false);
        for (place, v) in c.iter().enumerate() {
            assert_eq!(v.is_nan(), place / 17 == 3, "{isa}: place {place}");
        }
    }
}

#[test]
fn rows_are_taken_where_they_lie() {
    let values: Vec<f32> = (0..24_u8).map(f32::from).collect();
    let rows = Rows::new(&values, 4, 6).slice(1..3).columns(2, 3);
    assert_eq!((rows.count(), rows.width()), (2, 3));
    assert_eq!(rows.iter().collect::<Vec<_>>(), [[8.0, 9.0, 10.0], [14.0, 15.0, 16.0]]);
    assert_eq!(Rows::new(&values, 4, 6).slice(4..4).iter().count(), 0);
}

#[test]
fn shapes_that_do_not_fit_are_refused() {
    let refused = |work: &dyn Fn()| std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err();
    let (values, isa) = ([0.0; 12], sets()[0]);
    assert!(refused(&|| _ = Rows::new(&values, 5, 2)));
    assert!(refused(&|| _ = Rows::strided(&values, 4, 3, 4)));
    assert!(refused(&|| _ = Rows::strided(&values, 2, 3, 2)));
    assert!(refused(&|| _ = Rows::new(&values, 3, 4).columns(2, 3)));
    let packed = Packed::rows(isa, Rows::new(&values, 3, 4));
    assert!(refused(&|| multiply(Rows::new(&values, 3, 4), &packed, &mut [0.0; 12], 4, true)));
    assert!(refused(&|| multiply(Rows::new(&values, 4, 3), &packed, &mut [0.0; 15], 4, true)));
    assert!(refused(&|| multiply(Rows::new(&values, 4, 3), &packed, &mut [0.0; 16], 3, true)));
    let a = Rows::new(&values, 3, 4);
    assert!(refused(&|| multiply_transposed(isa, a, Rows::new(&values, 4, 3), &mut [0.0; 12], 3)));
    assert!(refused(&|| multiply_transposed(isa, a, a, &mut [0.0; 15], 4)));
    assert!(refused(&|| multiply_transposed(isa, a, a, &mut [0.0; 16], 3)));
}
