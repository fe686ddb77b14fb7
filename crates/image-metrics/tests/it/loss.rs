//! 1 - SSIM and its gradient on slices, against the f64 measure and its central differences.

use image_metrics::{Error, SSIM_WINDOW, SsimScratch, SsimTarget, psnr_rgb, ssim_rgb};
use proptest::prelude::*;

/// Loss and gradient, from nothing.
fn loss(a: &[f32], b: &[f32], width: usize, height: usize) -> (f64, Vec<f32>) {
    let mut gradient = vec![0.0; a.len()];
    let target = SsimTarget::new(b, width, height).expect("a picture");
    let loss = target.loss_with_gradient(a, 1.0, &mut gradient, &mut SsimScratch::default());
    (loss.expect("a picture of the same size"), gradient)
}

/// Derivative of 1 - SSIM by one value, from the f64 measure.
fn difference(a: &[f32], b: &[f32], width: usize, height: usize, at: usize) -> f64 {
    let moved = |by: f32| {
        let mut a = a.to_vec();
        a[at] += by;
        (f64::from(a[at]), 1.0 - ssim_rgb(&a, b, width, height).expect("comparable"))
    };
    let ((low, below), (high, above)) = (moved(-1.0 / 4096.0), moved(1.0 / 4096.0));
    (above - below) / (high - low)
}

fn assert_is_derivative(a: &[f32], b: &[f32], width: usize, height: usize, places: &[usize]) {
    let (found, gradient) = loss(a, b, width, height);
    let expected = 1.0 - ssim_rgb(a, b, width, height).expect("comparable");
    assert!((found - expected).abs() < 1e-6, "{width}x{height}: {found} for {expected}");
    let largest = gradient.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
    for &at in places {
        let expected = difference(a, b, width, height, at);
        let off = (f64::from(gradient[at]) - expected).abs();
        // As much again for what a finite step misses.
        assert!(
            off <= 2e-4 * f64::from(largest),
            "{width}x{height}, value {at}: {} for {expected}, of {largest}",
            gradient[at]
        );
    }
}

fn size() -> impl Strategy<Value = (usize, usize)> {
    prop_oneof![Just((11, 11)), Just((12, 17)), Just((32, 11)), (11usize..44, 11usize..30)]
}

/// Width, height and two pictures: from near equal to unlike, from dark to beyond white.
fn pair() -> impl Strategy<Value = (usize, usize, Vec<f32>, Vec<f32>)> {
    (size(), -0.5..1.0f32, -3.0..0.0f32).prop_flat_map(|((width, height), bias, contrast)| {
        let values = || prop::collection::vec(-0.5..0.5f32, width * height * 3);
        (values(), values()).prop_map(move |(a, b)| {
            let scale = 10f32.powf(contrast);
            let b: Vec<f32> = b.iter().map(|b| bias + 0.2 * b).collect();
            (width, height, a.iter().zip(&b).map(|(a, b)| b + scale * a).collect(), b)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn the_gradient_is_the_derivative(
        (width, height, a, b) in pair(),
        places in prop::collection::vec(any::<prop::sample::Index>(), 8),
    ) {
        let mut places: Vec<usize> = places.iter().map(|place| place.index(a.len())).collect();
        places.extend([0, width * 3 - 1, a.len() - 1]);
        assert_is_derivative(&a, &b, width, height, &places);
    }

    #[test]
    fn a_picture_that_equals_its_target_is_at_rest((width, height, a, _) in pair()) {
        prop_assert_eq!(loss(&a, &a, width, height), (0.0, vec![0.0; a.len()]));
    }

    #[test]
    fn the_weighted_gradient_is_added((width, height, a, b) in pair(), weight in -2.0..2.0f32) {
        let (expected, gradient) = loss(&a, &b, width, height);
        let target = SsimTarget::new(&b, width, height).unwrap();
        prop_assert_eq!((target.width(), target.height()), (width, height));
        let mut sum = b.clone();
        let mut scratch = SsimScratch::default();
        prop_assert_eq!(target.loss_with_gradient(&a, weight, &mut sum, &mut scratch).unwrap(), expected);
        for ((sum, b), gradient) in sum.iter().zip(&b).zip(&gradient) {
            prop_assert!((sum - (b + weight * gradient)).abs() <= 1e-6 * b.abs().max(gradient.abs()));
        }
    }
}

#[test]
fn flat_pictures_have_a_gradient() {
    let grey = |value: f32| vec![value; 20 * 14 * 3];
    // 1 - (2 a b + C₁) / (a² + b² + C₁): only the luminance differs.
    for (a, b) in [(0.2f32, 0.7f32), (0.98, 1.0), (0.0, 1.0), (0.0, 0.0), (-0.3, 0.4)] {
        assert_is_derivative(&grey(a), &grey(b), 20, 14, &[0, 5 * 60 + 30, 10 * 60 + 31]);
        let (a64, b64) = (f64::from(a), f64::from(b));
        let expected = (a64 - b64).powi(2) / (a64 * a64 + b64 * b64 + 1e-4);
        assert!((loss(&grey(a), &grey(b), 20, 14).0 - expected).abs() < 1e-6, "{a} {b}");
    }
}

/// Smooth, with a grain by `seed`.
fn picture(width: usize, height: usize, seed: usize) -> Vec<f32> {
    let value =
        |i: usize| 0.5 + 0.3 * ((i / 3) as f32 / 50.0).sin() + ((i * i + seed * i) % 997) as f32 / 9970.0;
    (0..width * height * 3).map(value).collect()
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let (width, height) = (75, 131);
    let (a, b) = (picture(width, height, 1), picture(width, height, 2));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (loss, gradient) = pool.install(|| loss(&a, &b, width, height));
        let bits: Vec<u32> = gradient.iter().map(|value| value.to_bits()).collect();
        (loss.to_bits(), bits, pool.install(|| ssim_rgb(&a, &b, width, height).unwrap().to_bits()))
    };
    let one = on(1);
    for threads in [2, 7, 20] {
        assert!(on(threads) == one, "{threads} threads");
    }
}

#[test]
fn scratch_serves_targets_of_any_size() {
    let mut scratch = SsimScratch::default();
    for (width, height) in [(40, 60), (11, 11), (33, 19), (40, 12), (64, 90), (40, 60)] {
        let (a, b) = (picture(width, height, 3), picture(width, height, 4));
        let target = SsimTarget::new(&b, width, height).unwrap();
        let mut gradient = vec![0.0; a.len()];
        let found = target.loss_with_gradient(&a, 1.0, &mut gradient, &mut scratch).unwrap();
        assert!((found, gradient) == loss(&a, &b, width, height), "{width}x{height}");
    }
}

#[test]
fn what_cannot_be_fitted_is_refused() {
    let grey = vec![0.5; 12 * 13 * 3];
    let target = SsimTarget::new(&grey, 12, 13).unwrap();
    let fit = |picture: &[f32]| {
        let mut gradient = vec![0.25; picture.len()];
        let error = target.loss_with_gradient(picture, 1.0, &mut gradient, &mut SsimScratch::default());
        assert!(gradient.iter().all(|&value| value == 0.25), "the gradient is as it was");
        error.unwrap_err()
    };
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1.1e6, f32::MIN] {
        let mut broken = grey.clone();
        broken[(3 * 12 + 5) * 3 + 1] = bad;
        let expected = |picture| {
            let (x, y, limit) = (5, 3, 1_000_000);
            if bad.is_finite() {
                Error::OutOfRange { picture, x, y, limit }
            } else {
                Error::NotFinite { picture, x, y }
            }
        };
        assert_eq!(fit(&broken), expected("fitted"));
        assert_eq!(SsimTarget::new(&broken, 12, 13).unwrap_err(), expected("target"));
    }
    let length = "the fitted picture has 3 values, expected 468 for 12x13 in three channels";
    assert_eq!(fit(&grey[..3]).to_string(), length);
    let short =
        target.loss_with_gradient(&grey, 1.0, &mut [0.0; 4], &mut SsimScratch::default()).unwrap_err();
    assert_eq!(short, Error::GradientLength { expected: 468, found: 4 });
    let minimum = SSIM_WINDOW;
    let small = SsimTarget::new(&grey[..12 * 10 * 3], 12, 10).unwrap_err();
    assert_eq!(small, Error::TooSmall { width: 12, height: 10, minimum });
    assert_eq!(SsimTarget::new(&[], 0, 0).unwrap_err(), Error::TooSmall { width: 0, height: 0, minimum });
    assert!(matches!(SsimTarget::new(&grey, usize::MAX, 13), Err(Error::Length { .. })));
}

#[test]
fn measures_of_slices_check_their_lengths() {
    let grey = [0.5; 12 * 13 * 3];
    assert_eq!(psnr_rgb(&grey, &grey, 12, 13), Ok(f64::INFINITY));
    assert_eq!(ssim_rgb(&grey, &grey, 12, 13), Ok(1.0));
    for measure in [psnr_rgb, ssim_rgb] {
        let found = measure(&grey, &grey[1..], 12, 13).unwrap_err();
        let expected = Error::Length { picture: "second", width: 12, height: 13, expected: 468, found: 467 };
        assert_eq!(found, expected);
        assert!(matches!(measure(&[], &[], 0, 0), Err(Error::TooSmall { .. })));
    }
    // f64 has the range for what f32 has; what variance is left is rounding, and the index stays one.
    let (low, high) = ([f32::MIN; 12 * 13 * 3], [f32::MAX; 12 * 13 * 3]);
    assert!(ssim_rgb(&low, &high, 12, 13).unwrap().abs() <= 1.0);
    assert_eq!(ssim_rgb(&high, &high, 12, 13), Ok(1.0));
}

#[test]
fn the_index_of_what_rounds_to_anything_is_one() {
    let picture = |values: [f32; 3]| -> Vec<f32> { values.into_iter().cycle().take(30 * 20 * 3).collect() };
    let values = [1e6, -1e6, 0.0, 999_999.9, 1e-30, -0.0, 1.0];
    for a in values {
        for b in values {
            let (found, gradient) = loss(&picture([a, b, a]), &picture([b, -a, a]), 30, 20);
            assert!((0.0..=2.0).contains(&found), "{a} {b}: {found}");
            assert!(gradient.iter().all(|value| value.is_finite()), "{a} {b}");
        }
    }
}
