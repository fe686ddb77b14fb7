//! Arrays in place beside what is stored of them, beside the reference, and beside differences.

use super::{Arrays, Field, agree_with_differences};
use crate::check::settings;
use crate::losses::{compare_gradients, pixels};
use crate::scenes::{camera, gaussians};
use glam::{DMat3, DVec3};
use gs_raster::{
    ActivatedGradients, Colors, Gradients, PixelGradients, Rasterizer, RenderSettings, Rendering, Style,
};
use gs_reference::tolerance::{AMBIGUOUS, f32_bound};
use gs_reference::{Profile, compare};
use gs_scene::{Camera, Intrinsics, LOG_SCALE, OPACITY_LOGIT};
use proptest::prelude::*;

impl Arrays {
    /// The same with scales of 1 and opacities of ½, whose logarithms and logits are 0.
    fn with_exact_logarithms(mut self) -> Self {
        self.scales.fill(1.0);
        self.opacities.fill(0.5);
        self
    }

    /// The chain rule the other way: gradients by what is stored, of those by these arrays.
    fn by_what_is_stored(&self, found: &ActivatedGradients) -> Gradients {
        let mut geometry = Vec::new();
        for at in 0..self.opacities.len() {
            let o = self.opacities[at];
            geometry.extend_from_slice(&found.means[3 * at..][..3]);
            geometry.extend_from_slice(&found.quats[4 * at..][..4]);
            geometry.extend((3 * at..3 * at + 3).map(|k| found.scales[k] * self.scales[k]));
            geometry.push(found.opacities[at] * o * (1.0 - o));
        }
        let used = gs_scene::sh_coefficients(self.kind.degree()) * 3;
        let (row, factor) = match self.kind {
            Colors::Rgb => (3, gs_scene::SH_C0),
            Colors::Sh { per_gaussian, .. } => (3 * per_gaussian, 1.0),
        };
        let sh = found.colors.chunks_exact(row).flat_map(|row| &row[..used]).map(|by| by * factor).collect();
        Gradients { geometry, sh, background: found.background, cameras: found.cameras.clone() }
    }
}

/// How the colours of Gaussians are given.
fn kind(degree: usize, choice: usize) -> Colors {
    let least = gs_scene::sh_coefficients(degree);
    match choice {
        0 if degree == 0 => Colors::Rgb,
        1 => Colors::Sh { degree, per_gaussian: least + 2 },
        _ => Colors::Sh { degree, per_gaussian: least },
    }
}

/// Some derivatives by every pixel.
fn weights(camera: &Camera) -> PixelGradients<'static> {
    let plane = |channels: usize| -> Vec<f32> {
        let n = camera.width() * camera.height() * channels;
        (0..n).map(|i| ((i * 7 + channels) % 13) as f32 / 13.0 - 0.4).collect()
    };
    PixelGradients { image: plane(3).into(), alpha: Some(plane(1)), depth: Some(plane(1)) }
}

fn bits(view: &Rendering) -> Vec<u32> {
    let depth = view.depth.iter().flatten();
    view.image.data().iter().chain(&view.alpha).chain(depth).map(|value| value.to_bits()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn arrays_in_place_equal_what_is_stored_to_the_bit_where_logarithms_are_exact(
        scene in gaussians(200), camera in camera(), choice in 0usize..3, antialias: bool,
    ) {
        let arrays = Arrays::of(&scene, kind(scene.sh_degree(), choice)).with_exact_logarithms();
        let stored = arrays.store().expect("valid");
        let profile = Profile { antialias, ..Profile::default() };
        let settings = settings(&profile, [0.2, 0.5, 0.9]);
        let mut rasterizer = Rasterizer::cpu();
        let expected = rasterizer.render(&stored, &camera, &settings).expect("valid");
        let found = rasterizer.render_activated(&arrays.view(), &[camera, camera], &settings).expect("valid");
        prop_assert_eq!(found.len(), 2);
        for found in found {
            prop_assert_eq!(bits(&found), bits(&expected));
            prop_assert_eq!(found.stats.visible, expected.stats.visible);
            prop_assert_eq!(found.stats.intersections, expected.stats.intersections);
        }
    }

    #[test]
    fn gradients_by_arrays_in_place_equal_those_by_what_is_stored_to_the_bit_where_logarithms_are_exact(
        scene in gaussians(200), cameras in prop::collection::vec(camera(), 0..3), choice in 0usize..3, antialias: bool,
    ) {
        let arrays = Arrays::of(&scene, kind(scene.sh_degree(), choice)).with_exact_logarithms();
        let stored = arrays.store().expect("valid");
        let profile = Profile { antialias, ..Profile::default() };
        let settings = RenderSettings { depth: true, ..settings(&profile, [0.2, 0.5, 0.9]) };
        let pixels: Vec<PixelGradients> = cameras.iter().map(weights).collect();
        let mut rasterizer = Rasterizer::cpu();
        let (views, tape) = rasterizer.record(&stored, &cameras, &settings).expect("valid");
        let expected = rasterizer.backward(&stored, &tape, &pixels).expect("valid").activated(&arrays.view());
        let (found_views, tape) = rasterizer.record_activated(&arrays.view(), &cameras, &settings).expect("valid");
        let found = rasterizer.backward_activated(&arrays.view(), &tape, &pixels).expect("valid");
        // In memory that holds something else.
        let mut again = found.clone();
        let numbers = [&mut again.means, &mut again.scales, &mut again.colors];
        numbers.into_iter().flatten().for_each(|number| *number = f32::NAN);
        again.quats.clear();
        rasterizer.backward_activated_into(&arrays.view(), &tape, &pixels, &mut again).expect("valid");
        prop_assert_eq!(&again, &found);
        for (found, expected) in found_views.iter().zip(&views) {
            prop_assert_eq!(bits(found), bits(expected));
        }
        prop_assert_eq!((found_views.len(), found.cameras.len()), (cameras.len(), cameras.len()));
        let numbers = |of: &ActivatedGradients| -> Vec<u32> {
            let arrays = [&of.means, &of.quats, &of.scales, &of.opacities, &of.colors];
            arrays.into_iter().flatten().map(|number| number.to_bits()).collect()
        };
        prop_assert_eq!(numbers(&found), numbers(&expected));
        prop_assert_eq!((found.background, found.cameras), (expected.background, expected.cameras));
    }

    #[test]
    fn arrays_in_place_agree_with_the_reference(
        scene in gaussians(40), camera in camera(), choice in 0usize..3, antialias: bool, seed: u64,
    ) {
        let profile = Profile { antialias, ..Profile::default() };
        let background = [0.2, 0.5, 0.9];
        let arrays = Arrays::of(&scene, kind(scene.sh_degree(), choice));
        let stored = arrays.store().expect("valid");
        let truth = gs_reference::render(&stored, &camera, background.map(f64::from), &profile);
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let pixels = pixels(seed, &ambiguous, &truth.alpha);
        let mut rasterizer = Rasterizer::cpu();
        let settings = settings(&profile, background);
        let (views, tape) = rasterizer.record_activated(&arrays.view(), &[camera], &settings).expect("valid");
        let view = &views[0];
        let depth = view.depth.as_ref().expect("asked for");
        let outputs = [
            ("image", view.image.data(), &truth.image),
            ("alpha", &view.alpha, &truth.alpha),
            ("depth", depth, &truth.depth),
        ];
        for (output, found, expected) in outputs {
            let deviation = compare(expected.iter().copied(), found.iter().copied(), &ambiguous).expect("comparable");
            let bound = f32_bound(&deviation, None);
            prop_assert!(deviation.max_abs <= bound, "{}: {:?}", output, deviation);
        }
        let found = rasterizer.backward_activated(&arrays.view(), &tape, std::slice::from_ref(&pixels)).expect("valid");
        let found = arrays.by_what_is_stored(&found);
        for compared in compare_gradients(&stored, &camera, background, &profile, &truth, &pixels, &found) {
            let row = compared.row();
            prop_assert!(row.holds(), "{}: {:?}, bound {:.1e}", row.output, row.deviation, row.bound);
        }
    }

    #[test]
    fn logarithms_are_rounded_once(scale in prop::num::f32::POSITIVE | prop::num::f32::SUBNORMAL, o in 0.0..=1.0f32) {
        let mut arrays = Arrays::new(Colors::Rgb);
        arrays.scales[0] = scale.abs();
        arrays.opacities[0] = o;
        prop_assume!(arrays.scales[0] > 0.0);
        let stored = arrays.store().expect("valid");
        let close = |found: f32, expected: f64| {
            (f64::from(found) - expected).abs() <= 0.51 * f64::from(expected.abs() as f32) * f64::from(f32::EPSILON)
        };
        let log = stored.geometry()[LOG_SCALE.start];
        prop_assert!(close(log, f64::from(scale).abs().ln()), "{} {}", scale, log);
        if (1e-30..1.0).contains(&o) {
            let logit = stored.geometry()[OPACITY_LOGIT];
            prop_assert!(close(logit, (f64::from(o) / (1.0 - f64::from(o))).ln()), "{} {}", o, logit);
        }
    }
}

#[test]
fn ellipsoids_of_arrays_are_those_of_what_is_stored() {
    let (camera, arrays) = one();
    let settings = RenderSettings { style: Style::Ellipsoids, ..RenderSettings::default() };
    let mut rasterizer = Rasterizer::cpu();
    let found = rasterizer.render_activated(&arrays.view(), &[camera], &settings).unwrap();
    let expected = rasterizer.render(&arrays.store().unwrap(), &camera, &settings).unwrap();
    assert!(expected.alpha.iter().any(|alpha| *alpha > 0.0));
    assert_eq!(bits(&found[0]), bits(&expected));
}

#[test]
fn limits_of_opacities_and_scales_have_finite_gradients() {
    let (camera, arrays) = one();
    let mut rasterizer = Rasterizer::cpu();
    let mut found = |arrays: &Arrays, weight: f32| {
        let (views, tape) =
            rasterizer.record_activated(&arrays.view(), &[camera], &RenderSettings::default()).unwrap();
        assert!(views[0].image.data().iter().all(|value| value.is_finite()));
        let pixels = PixelGradients { image: vec![weight; 16 * 16 * 3].into(), alpha: None, depth: None };
        rasterizer.backward_activated(&arrays.view(), &tape, &[pixels]).unwrap()
    };
    let mut by_opacity = |opacity: f32| {
        let arrays = Arrays { opacities: vec![opacity], ..arrays.clone() };
        found(&arrays, 1.0).opacities[0]
    };
    let (at_one, near_one) = (by_opacity(1.0), by_opacity(0.9999));
    assert!((at_one / near_one - 1.0).abs() < 1e-2, "{at_one} {near_one}");
    assert_eq!(by_opacity(0.0), 0.0);
    for scale in [f32::from_bits(1), f32::MIN_POSITIVE, 1e30, f32::MAX] {
        for axis in 0..3 {
            let mut arrays = arrays.clone();
            arrays.scales[axis] = scale;
            for weight in [1.0, f32::MAX] {
                let found = found(&arrays, weight);
                let gradients = [&found.means, &found.quats, &found.scales, &found.opacities, &found.colors];
                assert!(gradients.into_iter().flatten().all(|value| value.is_finite()), "{scale}: {found:?}");
                // A standard deviation beyond the limit is drawn as the limit.
                assert!(scale < 1.0 || found.scales[axis] == 0.0, "{scale}: {found:?}");
            }
        }
    }
}

/// One large Gaussian in the middle of a view.
fn one() -> (Camera, Arrays) {
    let lens = Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 8.0, width: 16, height: 16 };
    let arrays = Arrays {
        means: vec![0.1, -0.1, 3.0],
        quats: vec![0.9, 0.1, -0.2, 0.3],
        scales: vec![0.5, 0.4, 0.6],
        opacities: vec![0.6],
        colors: vec![0.8, 0.3, 0.5],
        kind: Colors::Rgb,
    };
    (Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("a valid camera"), arrays)
}

#[test]
fn gradients_of_activated_gaussians_agree_with_central_differences() {
    // Through the renderer, a loss by all pixels.
    let (camera, arrays) = one();
    let weights: Vec<f32> = (0..16 * 16 * 3).map(|i| 0.2 + (i * 7 % 13) as f32 / 15.0).collect();
    // Thresholds cut tails off: steps of the picture that a difference sees and a gradient does not. They are low here.
    let settings = RenderSettings {
        alpha_min: 1e-6,
        alpha_max: 0.9999,
        transmittance_min: 1e-12,
        ..RenderSettings::default()
    };
    let loss = |arrays: &Arrays| -> f64 {
        let views = Rasterizer::cpu().render_activated(&arrays.view(), &[camera], &settings).unwrap();
        views[0].image.data().iter().zip(&weights).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let mut rasterizer = Rasterizer::cpu();
    let (_, tape) = rasterizer.record_activated(&arrays.view(), &[camera], &settings).unwrap();
    let pixels = PixelGradients { image: (&weights).into(), alpha: None, depth: None };
    let found = rasterizer.backward_activated(&arrays.view(), &tape, &[pixels]).unwrap();
    let fields: [(Field, &Vec<f32>); 3] = [
        (|arrays| &mut arrays.scales, &found.scales),
        (|arrays| &mut arrays.opacities, &found.opacities),
        (|arrays| &mut arrays.colors, &found.colors),
    ];
    // The second derivative over a step of 1/256, and single pixels of 1e-6 at the rim.
    agree_with_differences(&arrays, &fields, loss, (1.0 / 256.0, 2e-2));
}
