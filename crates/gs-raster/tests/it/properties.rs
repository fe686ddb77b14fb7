//! What must hold for every scene.

use crate::check::settings;
use crate::scenes::{camera, gaussians, render};
use glam::DVec3;
use gs_raster::{RenderSettings, Rendering};
use gs_reference::tolerance::{AMBIGUOUS, F32_WITHOUT_FLOOR, f32_bound};
use gs_reference::{Profile, compare};
use gs_scene::{Camera, Gaussians};
use proptest::prelude::*;

const BACKGROUND: [f32; 3] = [0.2, 0.5, 0.9];

fn bits(view: &Rendering) -> Vec<u32> {
    let depth = view.depth.iter().flatten();
    view.image.data().iter().chain(&view.alpha).chain(depth).map(|value| value.to_bits()).collect()
}

/// The scene with its Gaussians in another order.
pub(crate) fn permuted(scene: &Gaussians, order: &[usize]) -> Gaussians {
    let k = gs_scene::sh_coefficients(scene.sh_degree()) * 3;
    let rows = |buffer: &[f32], row: usize| -> Vec<f32> {
        order.iter().flat_map(|&i| buffer[i * row..(i + 1) * row].to_vec()).collect()
    };
    Gaussians::new(scene.sh_degree(), rows(scene.geometry(), 11), rows(scene.sh(), k)).expect("valid")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn equals_the_reference(scene in gaussians(40), camera in camera(), antialias: bool) {
        let profile = Profile { antialias, ..Profile::default() };
        let truth = gs_reference::render(&scene, &camera, BACKGROUND.map(f64::from), &profile);
        let view = render(&scene, &camera, &settings(&profile, BACKGROUND)).expect("valid");
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let depth = view.depth.expect("valid");
        let outputs = [("image", truth.image, view.image.data()), ("alpha", truth.alpha, &view.alpha), ("depth", truth.depth, &depth)];
        for (output, expected, found) in outputs {
            let deviation = compare(expected, found.iter().copied(), &ambiguous).expect("valid");
            prop_assert!(deviation.max_abs <= f32_bound(&deviation, None), "{}: {:?}", output, deviation);
        }
    }

    #[test]
    fn the_order_of_the_scene_changes_nothing(scene in gaussians(40), camera in camera(), seed in 0usize..1000) {
        let mut order: Vec<usize> = (0..scene.len()).collect();
        order.sort_by_key(|i| (i * 7727 + seed * 31) % 1009);
        let render = |scene: &Gaussians| render(scene, &camera, &settings(&Profile::default(), BACKGROUND)).expect("valid");
        prop_assert_eq!(bits(&render(&scene)), bits(&render(&permuted(&scene, &order))));
    }

    #[test]
    fn the_scale_of_the_world_changes_nothing_but_depth(
        scene in gaussians(30), camera in camera(), exponent in -10..10i32,
    ) {
        // A power of two, so that no stored number is rounded but the logarithms of the scales.
        let factor = f64::from(exponent).exp2();
        let mut scaled = scene.clone();
        for row in scaled.buffers_mut().0.chunks_exact_mut(11) {
            row[..3].iter_mut().for_each(|value| *value *= factor as f32);
            row[7..10].iter_mut().for_each(|value| *value += factor.ln() as f32);
        }
        let moved = Camera::new(*camera.intrinsics(), camera.rotation(), camera.translation() * factor).expect("valid");
        let profile = Profile::default();
        let near = settings(&profile, BACKGROUND);
        let far = RenderSettings { near: near.near * factor as f32, far: near.far * factor as f32, ..near };
        let (a, b) = (render(&scene, &camera, &near).expect("valid"), render(&scaled, &moved, &far).expect("valid"));
        let truth = gs_reference::render(&scene, &camera, [0.0; 3], &profile);
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let image = compare(a.image.data().iter().copied(), b.image.data().iter().copied(), &ambiguous).expect("valid");
        prop_assert!(image.max_abs <= f32_bound(&image, None), "{:?}", image);
        let depth = a.depth.expect("valid").into_iter().map(|depth| f64::from(depth) * factor);
        let depth = compare(depth, b.depth.expect("valid"), &ambiguous).expect("valid");
        prop_assert!(depth.max_abs <= f32_bound(&depth, None), "{:?}", depth);
    }

    #[test]
    fn an_offset_of_the_world_changes_nothing(scene in gaussians(30), camera in camera()) {
        // Means on a grid of 2⁻⁸ keep all their bits at 1e4.
        let offset = DVec3::new(1e4, -8e3, 9e3);
        let (mut near, mut far) = (scene.clone(), scene);
        for (near, far) in near.buffers_mut().0.chunks_exact_mut(11).zip(far.buffers_mut().0.chunks_exact_mut(11)) {
            for (axis, shift) in offset.to_array().into_iter().enumerate() {
                near[axis] = (near[axis] * 256.0).round() / 256.0;
                far[axis] = near[axis] + shift as f32;
            }
        }
        let moved = Camera::new(
            *camera.intrinsics(), camera.rotation(), camera.translation() - camera.rotation() * offset,
        ).expect("valid");
        let settings = settings(&Profile::default(), BACKGROUND);
        let (a, b) = (render(&near, &camera, &settings).expect("valid"), render(&far, &moved, &settings).expect("valid"));
        let truth = gs_reference::render(&near, &camera, [0.0; 3], &Profile::default());
        let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
        prop_assume!(ambiguous.contains(&false));
        let image = compare(a.image.data().iter().copied(), b.image.data().iter().copied(), &ambiguous).expect("valid");
        prop_assert!(image.max_abs <= f32_bound(&image, None), "{:?}", image);
    }

    #[test]
    fn the_number_of_threads_changes_no_bit(scene in gaussians(60), camera in camera()) {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("valid");
            pool.install(|| bits(&render(&scene, &camera, &settings(&Profile::default(), BACKGROUND)).expect("valid")))
        };
        prop_assert_eq!(on(1), on(2));
    }

    #[test]
    fn depth_is_paid_for_only_when_asked_and_changes_no_colour(scene in gaussians(30), camera in camera()) {
        let with = settings(&Profile::default(), BACKGROUND);
        let (a, b) = (
            render(&scene, &camera, &with).expect("valid"),
            render(&scene, &camera, &RenderSettings { depth: false, ..with }).expect("valid"),
        );
        prop_assert!(b.depth.is_none());
        prop_assert_eq!(a.image, b.image);
        // A depth where something is drawn, inside the range of depths of the scene.
        for (depth, alpha) in a.depth.expect("valid").into_iter().zip(a.alpha) {
            prop_assert_eq!(depth > 0.0, alpha > 0.0);
            prop_assert!(depth < 10.0);
        }
    }
}

#[test]
fn many_gaussians_in_several_lists_equal_the_reference() {
    // More than one chunk of the projection and of the tile lists, and tiles that are done early.
    let mut scene = Gaussians::empty(0).expect("valid");
    let mut state = 9u32;
    let mut uniform = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    for i in 0..20_000 {
        let z = 2.0 + 4.0 * ((i * 7919) % 20_000) as f32 / 20_000.0;
        let mean = [z * (uniform() - 0.5), z * (uniform() - 0.5), z];
        let quaternion = [1.0, uniform(), uniform(), uniform()];
        let scale = [-5.0 + uniform(), -4.0 + uniform(), -5.0];
        scene.push(mean, quaternion, scale, 6.0 * uniform() - 2.0, &[uniform(), uniform(), uniform()]);
    }
    let lens = gs_scene::Intrinsics { fx: 40.0, fy: 40.0, cx: 20.0, cy: 20.0, width: 40, height: 40 };
    let camera = Camera::new(lens, glam::DMat3::IDENTITY, DVec3::ZERO).expect("valid");
    let profile = Profile::default();
    let truth = gs_reference::render(&scene, &camera, [0.0; 3], &profile);
    let view = render(&scene, &camera, &settings(&profile, [0.0; 3])).expect("valid");
    assert!(view.stats.visible > 16_384, "{:?}", view.stats);
    let ambiguous: Vec<bool> = truth.margin.iter().map(|&margin| margin < AMBIGUOUS).collect();
    let deviation = compare(truth.image, view.image.data().iter().copied(), &ambiguous).expect("valid");
    assert!(deviation.max_abs <= F32_WITHOUT_FLOOR * deviation.largest, "{deviation:?}");
}
