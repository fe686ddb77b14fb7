use crate::{PIXELS, camera, every_pixel, view};
use backproject::{Settings, ViewPixels, anchors};
use gs_scene::FeatureMap;
use proptest::prelude::*;

fn features(map: &FeatureMap, pixels: &[u32]) -> Vec<f32> {
    let (camera, depth) = (camera(), vec![1.0; PIXELS]);
    let view = ViewPixels { features: Some(map), ..view(&camera, &depth, pixels) };
    anchors(&[view], &Settings { normals: None, ..Settings::default() }).expect("sizes fit").anchors.features
}

/// The definition: the tent over pixel centres, in f64, of the map continued by its border.
fn bilinear(map: &FeatureMap, channel: usize, pixel: usize) -> f64 {
    let along = |pixel: usize, pixels: usize, size: usize, i: usize| {
        let at = ((pixel as f64 + 0.5) / pixels as f64 * size as f64 - 0.5).clamp(0.0, size as f64 - 1.0);
        (1.0 - (at - i as f64).abs()).max(0.0)
    };
    let mut sum = 0.0;
    for v in 0..map.height() {
        for u in 0..map.width() {
            let weight = along(pixel % 40, 40, map.width(), u) * along(pixel / 40, 30, map.height(), v);
            sum += weight * f64::from(map.channel(channel)[v * map.width() + u]);
        }
    }
    sum
}

proptest! {
    #[test]
    fn features_are_bilinear_whatever_the_size_of_the_map(
        channels in 1..10usize, width in 1..60usize, height in 1..45usize,
        values in prop::collection::vec(-1.0..1.0f32, 64), pixels in prop::collection::vec(0..PIXELS as u32, 1..20),
    ) {
        let data = (0..channels * width * height).map(|i| values[(i * 7 + i / 64) % 64]).collect();
        let map = FeatureMap::new(channels, width, height, data).unwrap();
        let found = features(&map, &pixels);
        prop_assert_eq!(found.len(), pixels.len() * channels);
        for (row, &pixel) in found.chunks(channels).zip(&pixels) {
            for (channel, &found) in row.iter().enumerate() {
                let expected = bilinear(&map, channel, pixel as usize);
                // Three nested interpolations of values below 1, in f32.
                prop_assert!((f64::from(found) - expected).abs() < 1e-6, "{found} for {expected}");
            }
        }
    }
}

#[test]
fn finite_values_of_a_map_of_the_pictures_size_come_out_equal() {
    let mut data: Vec<f32> = (0..3 * PIXELS).map(|i| (i as f32).sqrt()).collect();
    data[50] = f32::MAX;
    data[51] = f32::MIN;
    data[52] = -0.0;
    data[70] = f32::INFINITY;
    let map = FeatureMap::new(3, 40, 30, data).unwrap();
    for (pixel, row) in features(&map, &every_pixel()).chunks(3).enumerate() {
        for (c, &found) in row.iter().enumerate() {
            let given = map.channel(c)[pixel];
            assert!(
                found == given || !given.is_finite() && !found.is_finite(),
                "pixel {pixel}: {found}, {given}"
            );
        }
    }
}

#[test]
fn what_is_not_finite_stays_within_a_pixel_of_the_map() {
    // 10×10 pixels of the picture to one of the map.
    let mut data = vec![1.0; 12];
    data[5] = f32::NAN;
    let map = FeatureMap::new(1, 4, 3, data).unwrap();
    for (pixel, &found) in features(&map, &every_pixel()).iter().enumerate() {
        let near = (5..25).contains(&(pixel % 40)) && (5..25).contains(&(pixel / 40));
        assert_eq!(found.is_nan(), near, "pixel {pixel}");
    }
}

#[test]
fn a_map_without_channels_gives_no_features() {
    let map = FeatureMap::new(0, 4, 3, Vec::new()).unwrap();
    assert!(features(&map, &every_pixel()).is_empty());
}
