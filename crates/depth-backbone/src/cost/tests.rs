//! Costs against their definition in f64.

use super::*;
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Image, Intrinsics};
use proptest::prelude::*;

const LENS: Intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 10.0, cy: 8.0, width: 0, height: 0 };

fn texture(width: usize, height: usize, seed: u32) -> Texture {
    let random = |i: usize| (((i as u32 ^ seed).wrapping_mul(2_654_435_761) >> 13) % 256) as u8;
    let bytes: Vec<u8> = (0..width * height).flat_map(|i| [random(i); 3]).collect();
    Texture::new(&Image::from_rgb8(width, height, &bytes).unwrap())
}

fn camera(width: usize, height: usize, x: f64) -> Camera {
    let lens = Intrinsics { width, height, ..LENS };
    Camera::new(lens, DMat3::from_rotation_y(0.1 * x), DVec3::new(x, 0.05 * x, 0.0)).unwrap()
}

/// The definition in f64, pixel by pixel: bilinear samples of the whole window, ZNCC, the mean of the best two sources. Not a number
/// where a source sees the pixel so near its border that rounding decides whether it does.
fn plainly(reference: &Texture, sources: &[Source], w: impl Fn(usize) -> f32) -> Vec<f64> {
    let (width, height) = (reference.width, reference.height);
    let sample = |source: &Source, x: usize, y: usize| {
        let h = source.pair.project(x as f32 + 0.5, y as f32 + 0.5, w(y * width + x));
        let (u, v) = (f64::from(h.x / h.z), f64::from(h.y / h.z));
        let t = source.texture;
        let inside = h.z > 0.0 && (0.0..=t.width as f64).contains(&u) && (0.0..=t.height as f64).contains(&v);
        let (u, v) =
            ((u - 0.5).clamp(0.0, t.width as f64 - 1.0), (v - 0.5).clamp(0.0, t.height as f64 - 1.0));
        let texel = |x: f64, y: f64| {
            let (x, y) = ((x as usize).min(t.width - 1), (y as usize).min(t.height - 1));
            f64::from(t.values[y * t.width + x])
        };
        let (i, j) = (u.floor(), v.floor());
        let upper = texel(i, j) * (1.0 - u + i) + texel(i + 1.0, j) * (u - i);
        let lower = texel(i, j + 1.0) * (1.0 - u + i) + texel(i + 1.0, j + 1.0) * (u - i);
        (upper * (1.0 - v + j) + lower * (v - j), inside)
    };
    let on_border = |source: &Source, x: usize, y: usize| {
        let h = source.pair.project(x as f32 + 0.5, y as f32 + 0.5, w(y * width + x));
        let near = |u: f32, side: usize| u.abs() < 1e-3 || (u - side as f32).abs() < 1e-3;
        near(h.x / h.z, source.texture.width) || near(h.y / h.z, source.texture.height)
    };
    let cost = |source: &Source, x: usize, y: usize| {
        if on_border(source, x, y) {
            return f64::NAN;
        }
        if !sample(source, x, y).1 {
            return f64::from(OUTSIDE_COST);
        }
        let mut sums = [0.0; 5];
        for dy in 0..SIDE {
            for dx in 0..SIDE {
                let (x, y) = (clamped(x, dx, width), clamped(y, dy, height));
                let (a, b) = (f64::from(reference.values[y * width + x]), sample(source, x, y).0);
                let terms = [a, b, a * a, b * b, a * b];
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term / f64::from(WINDOW));
            }
        }
        let [a, b, aa, bb, ab] = sums;
        let noise = f64::from(NOISE_VARIANCE);
        (1.0 - (ab - a * b) / ((aa - a * a + noise) * (bb - b * b + noise)).sqrt()).clamp(0.0, 1.0)
    };
    let pixel = |i: usize| {
        let mut costs: Vec<f64> = sources.iter().map(|source| cost(source, i % width, i / width)).collect();
        if costs.iter().any(|cost| cost.is_nan()) {
            return f64::NAN;
        }
        costs.sort_by(f64::total_cmp);
        match costs[..] {
            [] => 1.0,
            [one] => one,
            [a, b, ..] => 0.5 * (a + b),
        }
    };
    (0..width * height).map(pixel).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn costs_are_those_of_the_definition_under_every_instruction_set(
        width in 1usize..40,
        height in prop_oneof![1usize..12, 33usize..40],
        count in 0usize..4,
        seed: u32,
    ) {
        let reference = texture(width, height, seed);
        let statistics = WindowStatistics::new(&reference);
        let reference_camera = camera(width, height, 0.0);
        let textures: Vec<Texture> = (1..=count).map(|i| texture(width + i, height, seed / 2 + i as u32)).collect();
        let sources: Vec<Source> = textures.iter().zip(1..).map(|(texture, i)| Source {
            texture,
            pair: Pair::new(&reference_camera, &camera(texture.width, texture.height, 0.2 * f64::from(i))),
        }).collect();
        let surface: Vec<f32> = (0..width * height).map(|i| 0.3 + 0.1 * (i as f32 * 0.05).sin()).collect();
        // At the last a source does not see much of the picture.
        let offsets: [f32; 3] = [-0.05, 0.02, 1.5];
        let ends = (0.01, 2.0);
        let reference = Reference { texture: &reference, statistics: &statistics };
        for isa in Isa::available() {
            let planes = offsets.map(|offset| f64::from(offset.clamp(ends.0, ends.1)));
            let about = Hypotheses::About { surface: &surface, offsets: &offsets, ends };
            for hypotheses in [Hypotheses::Planes(&planes), about] {
                let found = volume(isa, reference, &sources, hypotheses);
                prop_assert_eq!(found.len(), width * height * sgm::LANES);
                for (plane, offset) in offsets.iter().enumerate() {
                    let w = |i: usize| (hypotheses.surface().map_or(0.0, |w| w[i]) + offset).clamp(ends.0, ends.1);
                    let expected = plainly(reference.texture, &sources, w);
                    for (i, expected) in expected.iter().enumerate() {
                        let found = f64::from(found[i * sgm::LANES + plane]) / f64::from(COST_LEVELS);
                        prop_assert!(expected.is_nan() || (found - expected).abs() < 0.003, "{} pixel {}: {} {}", isa, i, found, expected);
                    }
                }
                prop_assert!(found.chunks(sgm::LANES).all(|costs| costs[offsets.len()..].iter().all(|&c| c == BEYOND)));
            }
            let found = surface_costs(isa, reference, &sources, &surface, ends);
            for (found, expected) in found.iter().zip(plainly(reference.texture, &sources, |i| surface[i])) {
                prop_assert!(expected.is_nan() || (f64::from(*found) - expected).abs() < 0.002, "{} {}", found, expected);
            }
        }
    }
}
