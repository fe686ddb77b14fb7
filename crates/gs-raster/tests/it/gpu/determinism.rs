//! The same bytes from run to run, whatever was rendered before.

use super::{another_gpu, bits, gpu, gradient_bits};
use crate::losses::noise;
use crate::parity::crowd;
use crate::scenes::{camera, gaussians};
use glam::{DMat3, DVec3};
use gs_raster::{PixelGradients, Rasterizer, RenderSettings};
use gs_reference::compare;
use gs_reference::tolerance::f32_bound;
use gs_scene::{Camera, Gaussians, Intrinsics, sh_coefficients};
use proptest::prelude::*;

fn settings() -> RenderSettings {
    RenderSettings { background: [0.2, 0.5, 0.9], near: 0.2, depth: true, ..RenderSettings::default() }
}

/// Every bit of a rendering and of its gradients.
fn all_bits(rasterizer: &mut Rasterizer, scene: &Gaussians, camera: &Camera) -> (Vec<u32>, Vec<u64>) {
    let n = camera.width() * camera.height();
    let plane = |seed, n| -> Vec<f32> { (0..n).map(|i| noise(seed, i)).collect() };
    let loss =
        PixelGradients { image: plane(1, 3 * n).into(), alpha: Some(plane(2, n)), depth: Some(plane(3, n)) };
    let (views, tape) = rasterizer.record(scene, &[*camera], &settings()).expect("valid");
    let gradients = rasterizer.backward(scene, &tape, &[loss]).expect("valid");
    (bits(&views[0]), gradient_bits(&gradients))
}

/// A few Gaussians that cover a picture of many tiles: more pairs than a scene of that size is given room for.
fn covering() -> (Gaussians, Camera) {
    let mut scene = Gaussians::empty(0).expect("degree 0 exists");
    for i in 0..4 {
        let quaternion = [noise(50, i), noise(51, i), noise(52, i), noise(53, i)];
        scene.push(
            [0.1 * noise(54, i), 0.0, 2.0 + i as f32],
            quaternion,
            [1.0; 3],
            -2.0,
            &[0.1, noise(55, i), 0.4],
        );
    }
    let lens = Intrinsics { fx: 120.0, fy: 124.0, cx: 100.0, cy: 70.0, width: 211, height: 131 };
    (scene, Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid"))
}

fn small() -> (Gaussians, Camera) {
    let mut scene = Gaussians::empty(2).expect("degree 2 exists");
    for i in 0..3 {
        let sh: Vec<f32> = (0..27).map(|k| noise(60 + k, i)).collect();
        scene.push([0.1 * i as f32, 0.0, 2.0 + i as f32], [1.0, 0.1, 0.2, 0.3], [-2.0; 3], 1.0, &sh);
    }
    let lens = Intrinsics { fx: 20.0, fy: 20.0, cx: 8.0, cy: 8.0, width: 19, height: 5 };
    (scene, Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid"))
}

#[test]
#[ignore = "gpu"]
fn frames_do_not_depend_on_those_before() {
    let scenes = [small(), crowd(), covering()];
    let alone = scenes.each_ref().map(|(scene, camera)| all_bits(&mut another_gpu(), scene, camera));
    // Buffers that others left, larger and smaller ones, and room for pairs that grows on the way.
    let mut used = another_gpu();
    for place in [0, 1, 0, 2, 2, 0, 1, 1, 2] {
        let (scene, camera) = &scenes[place];
        assert!(all_bits(&mut used, scene, camera) == alone[place], "scene {place}");
        assert!(all_bits(&mut gpu(), scene, camera) == alone[place], "scene {place}, among the other tests");
    }
}

#[test]
#[ignore = "gpu"]
fn room_for_pairs_grows() {
    let (scene, camera) = covering();
    let mut fresh = another_gpu();
    let view = fresh.render(&scene, &camera, &settings()).expect("valid");
    assert!(view.stats.intersections > 4 * 14 * 9 - 9, "{:?}", view.stats);
    let on_cpu = Rasterizer::cpu().render(&scene, &camera, &settings()).expect("valid");
    let deviation = compare(on_cpu.alpha, view.alpha, &[]).expect("comparable");
    assert!(deviation.max_abs <= f32_bound(&deviation, None), "{deviation:?}");
}

#[test]
#[ignore = "gpu"]
fn without_poison_nothing_changes() {
    let (scene, camera) = crowd();
    let options = gs_raster::gpu::GpuOptions { poison: false, ..super::OPTIONS };
    let mut plain = Rasterizer::gpu(&options).expect("an adapter");
    let poisoned = all_bits(&mut gpu(), &scene, &camera);
    for _ in 0..2 {
        assert!(all_bits(&mut plain, &scene, &camera) == poisoned);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    #[ignore = "gpu"]
    fn the_order_of_the_scene_changes_nothing(scene in gaussians(40), camera in camera(), seed in 0usize..1000) {
        let mut order: Vec<usize> = (0..scene.len()).collect();
        order.sort_by_key(|i| (i * 7727 + seed * 31) % 1009);
        let k = sh_coefficients(scene.sh_degree()) * 3;
        let rows = |buffer: &[f32], row: usize| -> Vec<f32> {
            order.iter().flat_map(|&i| buffer[i * row..(i + 1) * row].to_vec()).collect()
        };
        let geometry = rows(scene.geometry(), Gaussians::GEOMETRY);
        let permuted = Gaussians::new(scene.sh_degree(), geometry, rows(scene.sh(), k)).expect("valid");
        let n = camera.width() * camera.height();
        let image = (0..3 * n).map(|i| noise(seed as u64, i)).collect();
        let loss = PixelGradients { image, alpha: None, depth: None };
        let mut gpu = gpu();
        let mut run = |scene: &Gaussians| {
            let (views, tape) = gpu.record(scene, &[camera], &settings()).expect("valid");
            (bits(&views[0]), gpu.backward(scene, &tape, std::slice::from_ref(&loss)).expect("valid"))
        };
        let ((view, gradients), (other_view, other)) = (run(&scene), run(&permuted));
        prop_assert_eq!(view, other_view);
        prop_assert_eq!(rows(&gradients.geometry, Gaussians::GEOMETRY), other.geometry);
        prop_assert_eq!(rows(&gradients.sh, k), other.sh);
        prop_assert_eq!(gradients.cameras, other.cameras);
        prop_assert_eq!(gradients.background, other.background);
    }
}
