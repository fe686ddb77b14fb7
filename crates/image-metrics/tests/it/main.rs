//! Against scikit-image, against the definition, and what must be refused.

mod golden;
mod loss;
#[cfg(feature = "lpips")]
mod lpips;
#[cfg(feature = "lpips")]
mod recipe;

use gs_scene::Image;
use image_metrics::{Error, psnr, ssim};
use proptest::prelude::*;
use std::path::Path;

#[test]
fn figures_equal_those_of_scikit_image() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/image-metrics/metrics.safetensors");
    let pairs = golden::deviations(&file);
    assert_eq!(pairs.len(), 8);
    for (pair, psnr, ssim) in pairs {
        assert!(psnr <= golden::TOLERANCE && ssim <= golden::TOLERANCE, "{pair}: {psnr:e} dB, {ssim:e}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let grey = |width, height| Image::filled(width, height, [0.5; 3]).unwrap();
    let size = "the first picture is 12x12, the second 12x13, expected equal sizes";
    assert_eq!(psnr(&grey(12, 12), &grey(12, 13)).unwrap_err().to_string(), size);
    assert_eq!(ssim(&grey(12, 12), &grey(12, 13)).unwrap_err().to_string(), size);
    let small = ssim(&grey(40, 10), &grey(40, 10)).unwrap_err();
    assert_eq!(small.to_string(), "the pictures are 40x10, expected at least 11x11");
    assert!(ssim(&grey(11, 11), &grey(11, 11)).is_ok());
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut broken = grey(12, 12);
        broken.data_mut()[(3 * 12 + 5) * 3 + 1] = bad;
        let expected = |picture| Error::NotFinite { picture, x: 5, y: 3 };
        assert_eq!(psnr(&broken, &grey(12, 12)), Err(expected("first")));
        assert_eq!(ssim(&grey(12, 12), &broken), Err(expected("second")));
    }
    let text = Error::NotFinite { picture: "first", x: 5, y: 3 }.to_string();
    assert_eq!(text, "the first picture is not finite in column 5, row 3");
}

#[test]
fn psnr_clips_and_ssim_does_not() {
    let (black, below) =
        (Image::filled(12, 12, [0.0; 3]).unwrap(), Image::filled(12, 12, [-3.0; 3]).unwrap());
    assert_eq!(psnr(&black, &below).unwrap(), f64::INFINITY);
    assert!(ssim(&black, &below).unwrap() < 0.5);
}

/// The definition, window by window, without separation of the axes.
fn ssim_by_definition(a: &Image, b: &Image) -> f64 {
    let weight = |i: usize| (-(i as f64 - 5.0).powi(2) / 4.5).exp();
    let total: f64 = (0..11).map(weight).sum::<f64>().powi(2);
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 0..=a.height() - 11 {
        for x in 0..=a.width() - 11 {
            for channel in 0..3 {
                let mean = |f: &dyn Fn(f64, f64) -> f64| {
                    let mut mean = 0.0;
                    for (i, j) in (0..121).map(|k| (k / 11, k % 11)) {
                        let value = |image: &Image| f64::from(image.pixel(x + j, y + i)[channel]);
                        mean += weight(i) * weight(j) / total * f(value(a), value(b));
                    }
                    mean
                };
                let (ma, mb) = (mean(&|a, _| a), mean(&|_, b| b));
                let va = mean(&|a, _| (a - ma).powi(2)) * 121.0 / 120.0;
                let vb = mean(&|_, b| (b - mb).powi(2)) * 121.0 / 120.0;
                let cov = mean(&|a, b| (a - ma) * (b - mb)) * 121.0 / 120.0;
                sum += (2.0 * ma * mb + 1e-4) * (2.0 * cov + 9e-4)
                    / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
                count += 1.0;
            }
        }
    }
    sum / count
}

fn pair() -> impl Strategy<Value = (Image, Image)> {
    (11usize..20, 11usize..16).prop_flat_map(|(width, height)| {
        let data = || prop::collection::vec(-0.2..1.2f32, width * height * 3);
        (data(), data()).prop_map(move |(a, b)| {
            (
                Image::new(width, height, a).expect("a picture"),
                Image::new(width, height, b).expect("a picture"),
            )
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn ssim_equals_its_definition((a, b) in pair()) {
        prop_assert!((ssim(&a, &b).unwrap() - ssim_by_definition(&a, &b)).abs() < 1e-12);
    }

    #[test]
    fn measures_are_symmetric_and_equal_on_any_number_of_threads((a, b) in pair()) {
        let both = || (psnr(&a, &b).unwrap(), ssim(&a, &b).unwrap());
        prop_assert_eq!(both().0, psnr(&b, &a).unwrap());
        prop_assert!((both().1 - ssim(&b, &a).unwrap()).abs() < 1e-12);
        prop_assert!(both().1 <= 1.0);
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        prop_assert_eq!(pool(1).install(both), pool(3).install(both));
    }
}
