//! Several views of one scene at once.

use super::{bits, gpu, gradient_bits};
use crate::activated::Arrays;
use crate::losses::noise;
use crate::parity::crowd;
use crate::scenes::backward;
use glam::{DMat3, DVec3, EulerRot};
use gs_raster::{Colors, Error, PixelGradients, Rasterizer, RenderSettings};
use gs_reference::compare;
use gs_reference::tolerance::F32_LEAST;
use gs_scene::{Camera, Intrinsics};

/// Pictures of different sizes, from different places.
fn cameras() -> [Camera; 3] {
    [(40, 31, 0.0), (64, 16, 0.1), (17, 50, -0.2)].map(|(width, height, angle)| {
        let (cx, cy) = (0.5 * f64::from(width), 0.4 * f64::from(height));
        let (width, height) = (width as usize, height as usize);
        let lens = Intrinsics { fx: 45.0, fy: 44.0, cx, cy, width, height };
        let rotation = DMat3::from_euler(EulerRot::XYZ, angle, -0.5 * angle, 2.0 * angle);
        Camera::new(lens, rotation, DVec3::new(angle, 0.2, 0.5 * angle)).expect("valid")
    })
}

fn losses(cameras: &[Camera]) -> Vec<PixelGradients<'static>> {
    let plane = |seed, n| -> Vec<f32> { (0..n).map(|i| noise(seed, i)).collect() };
    cameras
        .iter()
        .zip(40..)
        .map(|(camera, seed)| {
            let n = camera.width() * camera.height();
            PixelGradients { image: plane(seed, 3 * n).into(), alpha: Some(plane(seed + 10, n)), depth: None }
        })
        .collect()
}

fn settings() -> RenderSettings {
    RenderSettings {
        background: [0.2, 0.5, 0.9],
        near: 0.2,
        depth: true,
        antialias: true,
        ..RenderSettings::default()
    }
}

#[test]
#[ignore = "gpu"]
fn views_are_those_rendered_one_by_one() {
    let ((scene, _), cameras) = (crowd(), cameras());
    let mut gpu = gpu();
    let together = gpu.render_views(&scene, &cameras, &settings()).unwrap();
    assert_eq!(together.len(), cameras.len());
    for (view, camera) in together.iter().zip(&cameras) {
        assert_eq!(bits(view), bits(&gpu.render(&scene, camera, &settings()).unwrap()));
        // What is kept for the backward pass changes no bit.
        assert_eq!(bits(view), bits(&gpu.record(&scene, &[*camera], &settings()).unwrap().0[0]));
    }
}

#[test]
#[ignore = "gpu"]
fn gradients_are_the_sum_of_those_of_the_views_and_poses_are_their_own() {
    let ((scene, _), cameras) = (crowd(), cameras());
    let losses = losses(&cameras);
    let mut gpu = gpu();
    let (_, tape) = gpu.record(&scene, &cameras, &settings()).unwrap();
    let together = gpu.backward(&scene, &tape, &losses).unwrap();
    let (mut geometry, mut sh) = (vec![0.0; together.geometry.len()], vec![0.0; together.sh.len()]);
    let mut background = [0.0; 3];
    assert_eq!(together.cameras.len(), cameras.len());
    for ((camera, loss), pose) in cameras.iter().zip(&losses).zip(&together.cameras) {
        let (_, tape) = gpu.record(&scene, &[*camera], &settings()).unwrap();
        let alone = gpu.backward(&scene, &tape, std::slice::from_ref(loss)).unwrap();
        assert_eq!(alone.cameras, [*pose]);
        assert!(pose.translation.length() > 0.0);
        let on_cpu = backward(&scene, camera, &settings(), loss).cameras[0].focal;
        assert!(
            (pose.focal - on_cpu).abs() < 1e-3 * on_cpu.abs().max(1.0),
            "{} on the CPU {on_cpu}",
            pose.focal
        );
        for (sums, parts) in [(&mut geometry, &alone.geometry), (&mut sh, &alone.sh)] {
            assert!(parts.iter().any(|&value| value != 0.0));
            sums.iter_mut().zip(parts).for_each(|(sum, &part)| *sum += f64::from(part));
        }
        background.iter_mut().zip(alone.background).for_each(|(sum, part)| *sum += part);
    }
    for (expected, found) in [(geometry, &together.geometry), (sh, &together.sh)] {
        let deviation = compare(expected, found.iter().copied(), &[]).unwrap();
        assert!(deviation.max_abs <= F32_LEAST * deviation.largest, "{deviation:?}");
    }
    let deviation = compare(background, together.background, &[]).unwrap();
    assert!(deviation.max_abs <= F32_LEAST * deviation.largest, "{deviation:?}");
}

#[test]
#[ignore = "gpu"]
fn a_tape_can_be_differentiated_twice_and_after_other_frames() {
    let ((scene, other), cameras) = (crowd(), cameras());
    let losses = losses(&cameras);
    let mut gpu = gpu();
    let (_, tape) = gpu.record(&scene, &cameras, &settings()).unwrap();
    let first = gpu.backward(&scene, &tape, &losses).unwrap();
    gpu.render(&scene, &other, &settings()).unwrap();
    assert_eq!(gradient_bits(&gpu.backward(&scene, &tape, &losses).unwrap()), gradient_bits(&first));
}

#[test]
#[ignore = "gpu"]
fn arrays_have_the_pictures_and_gradients_of_what_is_stored_of_them() {
    let ((scene, _), cameras) = (crowd(), cameras());
    let losses = losses(&cameras);
    let kind = Colors::Sh { degree: scene.sh_degree(), per_gaussian: 16 };
    let arrays = Arrays::of(&scene, kind);
    let stored = arrays.store().unwrap();
    let mut gpu = gpu();
    let (expected_views, tape) = gpu.record(&stored, &cameras, &settings()).unwrap();
    let expected = gpu.backward(&stored, &tape, &losses).unwrap().activated(&arrays.view());
    let (views, tape) = gpu.record_activated(&arrays.view(), &cameras, &settings()).unwrap();
    for (found, expected) in views.iter().zip(&expected_views) {
        assert_eq!(bits(found), bits(expected));
    }
    assert_eq!(gpu.backward_activated(&arrays.view(), &tape, &losses).unwrap(), expected);
    assert!(expected.scales.iter().any(|&value| value != 0.0));
    // A tape belongs to its device.
    let elsewhere = Rasterizer::cpu().backward_activated(&arrays.view(), &tape, &losses);
    assert!(matches!(elsewhere, Err(Error::OtherDevice)), "{elsewhere:?}");
}

#[test]
#[ignore = "gpu"]
fn no_views_have_no_gradient() {
    let (scene, _) = crowd();
    let mut gpu = gpu();
    assert!(gpu.render_views(&scene, &[], &settings()).unwrap().is_empty());
    let (views, tape) = gpu.record(&scene, &[], &settings()).unwrap();
    assert!(views.is_empty());
    let gradients = gpu.backward(&scene, &tape, &[]).unwrap();
    assert_eq!(gradients.geometry, vec![0.0; scene.geometry().len()]);
    assert_eq!(gradients.sh, vec![0.0; scene.sh().len()]);
    assert!(gradients.cameras.is_empty());
}
