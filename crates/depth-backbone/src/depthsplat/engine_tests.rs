//! The kernels against candle's operations, layer by layer through whole networks: two implementations of all layers, of
//! which the composed one is also what runs on GPUs.

use super::*;
use glam::DVec3;
use gs_scene::{Camera, Image, Intrinsics};

fn views(count: usize, width: usize, height: usize) -> Vec<View> {
    let lens = Intrinsics { fx: 50.0, fy: 52.0, cx: 25.0, cy: 15.0, width, height };
    let view = |i: usize| {
        let position = DVec3::new(0.3 * i as f64, 0.05 * (i * i) as f64, -0.1 * i as f64);
        let up = DVec3::new(0.0, -1.0, 0.0);
        let camera = Camera::looking_at(lens, position, DVec3::new(0.2, 0.1, 4.0), up).unwrap();
        let value = |k: usize| 0.5 + 0.4 * (k as f32 * 0.013 + i as f32).sin() * (k as f32 * 0.31).cos();
        let image = Image::new(width, height, (0..width * height * 3).map(value).collect()).unwrap();
        View::new(i.to_string(), image, camera, None).unwrap()
    };
    (0..count).map(view).collect()
}

fn check(scales: Scales, count: usize, width: usize, height: usize) {
    let variant = Variant { scales, vit: Vit::Small };
    let views = views(count, width, height);
    let ranges = vec![(0.5, 50.0); count];
    let maps = |engine| {
        let network = DepthSplat::untrained_with(variant, "engines", engine).unwrap();
        network.trace(&views, &ranges, true).unwrap().1.maps
    };
    let (kernels, composed) = (maps(Engine::Kernels), maps(Engine::Composed));
    assert!(kernels.len() > 60 && kernels.len() == composed.len());
    for (a, b) in kernels.iter().zip(&composed) {
        assert_eq!((&a.name, &a.shape), (&b.name, &b.shape));
        let squares = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            a.values.iter().zip(&b.values).map(|(&a, &b)| f(a.into(), b.into()).powi(2)).sum()
        };
        let deviation = (squares(&|a, b| a - b) / squares(&|_, b| b)).sqrt();
        // f32 in another order, through up to a hundred layers.
        assert!(deviation < 5e-5, "{} of {variant}: {deviation:.1e}", a.name);
    }
}

#[test]
fn engines_agree_on_one_scale() {
    // Four views: neighbours are chosen. The width is padded.
    check(Scales::Eighth, 4, 50, 32);
}

#[test]
fn engines_agree_on_two_scales() {
    check(Scales::QuarterHalf, 3, 48, 32);
}
