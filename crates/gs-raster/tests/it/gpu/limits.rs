//! What cannot be done is an error that says so, and the GPU goes on after it.

use super::{OPTIONS, another_gpu, gpu};
use glam::{DMat3, DVec3};
use gs_raster::gpu::GpuOptions;
use gs_raster::{Error, PixelGradients, Rasterizer, RenderSettings};
use gs_reference::compare;
use gs_reference::tolerance::F32_WITHOUT_FLOOR;
use gs_scene::{Camera, Gaussians, Intrinsics};

const GOOD: [f32; 11] = [0.0, 0.0, 2.0, 1.0, 0.2, 0.1, 0.3, -1.5, -1.0, -2.0, 1.0];

fn camera(width: usize, height: usize) -> Camera {
    let focal = 1.1 * width.max(height) as f64;
    let lens =
        Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f64, cy: 0.5 * height as f64, width, height };
    Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid")
}

fn scene(n: usize, log_scale: f32) -> Gaussians {
    let mut row = GOOD;
    row[7..10].fill(log_scale);
    Gaussians::new(0, row.repeat(n), vec![0.5; 3 * n]).expect("valid")
}

fn loss(camera: &Camera) -> PixelGradients<'static> {
    PixelGradients { image: vec![0.5; camera.width() * camera.height() * 3].into(), alpha: None, depth: None }
}

/// One that binds a mebibyte.
fn smaller_gpu() -> Rasterizer {
    Rasterizer::gpu(&GpuOptions { largest_binding: Some(1 << 20), ..OPTIONS }).expect("an adapter")
}

/// A failed call leaves nothing behind.
fn still_renders(gpu: &mut Rasterizer) {
    let (scene, camera) = (scene(1, -1.0), camera(20, 20));
    let view = gpu.render(&scene, &camera, &RenderSettings::default()).expect("valid");
    let on_cpu = Rasterizer::cpu().render(&scene, &camera, &RenderSettings::default()).expect("valid");
    assert_eq!(view.stats.intersections, on_cpu.stats.intersections);
    assert!(view.alpha.iter().copied().fold(0.0, f32::max) > 0.5);
}

#[test]
#[ignore = "gpu"]
fn too_many_intersections() {
    // 256 × 64 tiles, each touched by every Gaussian: more than are listed, then more than 2³².
    for n in [20_000, 280_000] {
        let (scene, camera) = (scene(n, 20.0), camera(4096, 1024));
        let mut gpu = gpu();
        match gpu.render(&scene, &camera, &RenderSettings::default()) {
            Err(Error::TooManyIntersections { found, limit }) => {
                assert_eq!(found, (n as u64 * 256 * 64).min(u64::from(u32::MAX)));
                assert!(limit <= 1 << 28);
            }
            other => panic!("{n}: {:?}", other.map(|view| view.stats)),
        }
        still_renders(&mut gpu);
    }
}

#[test]
#[ignore = "gpu"]
fn a_picture_that_is_too_large() {
    let (mut gpu, scene) = (gpu(), scene(1, -1.0));
    // More tiles in a row than a dispatch has workgroups.
    for (width, height) in [(1, 1_048_561), (1_048_561, 1)] {
        match gpu.render(&scene, &camera(width, height), &RenderSettings::default()) {
            Err(Error::ImageTooLongForGpu { found: 1_048_561, limit: 1_048_560 }) => {}
            other => panic!("{width} × {height}: {:?}", other.map(|view| view.stats)),
        }
        still_renders(&mut gpu);
    }
    // No adapter binds 14 GB.
    match gpu.render(&scene, &camera(30_000, 30_000), &RenderSettings::default()) {
        Err(Error::TooLargeForGpu { what: "pixels", bytes: 14_400_000_000, .. }) => {}
        other => panic!("{:?}", other.map(|view| view.stats)),
    }
    still_renders(&mut gpu);
}

#[test]
#[ignore = "gpu"]
fn a_scene_that_is_too_large() {
    let mut gpu = smaller_gpu();
    let most = gpu.adapter().expect("a GPU").most_gaussians(0);
    assert_eq!(most, (1 << 20) / 56, "footprints are the largest");
    let scene = scene(most as usize + 1, -1.0);
    match gpu.render(&scene, &camera(20, 10), &RenderSettings::default()) {
        Err(Error::TooLargeForGpu { bytes, limit, .. }) => assert!(bytes > limit),
        other => panic!("{:?}", other.map(|view| view.stats)),
    }
    still_renders(&mut gpu);
}

#[test]
#[ignore = "gpu"]
fn a_picture_that_is_too_large_to_be_differentiated() {
    // Four numbers per pixel fit, the six of its gradients do not.
    let (mut gpu, scene, camera) = (smaller_gpu(), scene(1, -1.0), camera(250, 200));
    assert!(gpu.render(&scene, &camera, &RenderSettings::default()).is_ok());
    match gpu.record(&scene, &[camera], &RenderSettings::default()) {
        Err(Error::TooLargeForGpu { what: "pixel gradients", bytes: 1_200_000, limit: 1_048_576 }) => {}
        other => panic!("{:?}", other.map(|(views, _)| views[0].stats)),
    }
    still_renders(&mut gpu);
}

#[test]
#[ignore = "gpu"]
fn the_longest_picture_is_drawn() {
    let mut gpu = gpu();
    // The Gaussian lies in the first tile; rows of tiles are folded by nobody, 65535 are the most that there are.
    let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 0.5, cy: 8.0, width: 1, height: 1_048_560 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
    let view = gpu.render(&scene(1, -1.0), &camera, &RenderSettings::default()).expect("valid");
    assert!(view.alpha[8] > 0.5);
    assert!(view.alpha[1000..].iter().all(|&alpha| alpha == 0.0));
}

#[test]
#[ignore = "gpu"]
fn one_gaussian_over_thousands_of_tiles() {
    let scene = scene(1, 12.0);
    let mut gpu = gpu();
    let opacity = 1.0 / (1.0 + (-1.0f32).exp());
    let view = gpu.render(&scene, &camera(2100, 1500), &RenderSettings::default()).expect("valid");
    assert_eq!(view.stats.intersections, 132 * 94);
    let deviation = compare(vec![opacity; 2100 * 1500], view.alpha, &[]).expect("comparable");
    assert!(deviation.max_abs <= F32_WITHOUT_FLOOR, "{deviation:?}");

    let camera = camera(1050, 750);
    let (_, tape) = gpu.record(&scene, &[camera], &RenderSettings::default()).expect("valid");
    let gradients = gpu.backward(&scene, &tape, &[loss(&camera)]).expect("valid");
    assert!(gradients.geometry.iter().chain(&gradients.sh).all(|value| value.is_finite()));
    // By colour: the loss's weight times opacity times Y₀, summed over all pixels.
    let expected = 0.5 * f64::from(opacity) * 0.282_094_791_773_878_14 * 1050.0 * 750.0;
    for &by in &gradients.sh {
        assert!(
            (f64::from(by) - expected).abs() <= F32_WITHOUT_FLOOR * expected,
            "{by}, expected {expected}"
        );
    }
}

#[test]
#[ignore = "gpu"]
fn pixel_gradients_that_do_not_fit_what_was_recorded() {
    let (recorded, camera) = (scene(2, -1.0), camera(20, 10));
    let mut gpu = gpu();
    let settings = RenderSettings::default();
    let (_, tape) = gpu.record(&recorded, &[camera, camera], &settings).expect("valid");
    let good = loss(&camera);
    let mut backward = |scene: &Gaussians, pixels: &[PixelGradients]| gpu.backward(scene, &tape, pixels);
    assert!(backward(&recorded, &[good.clone(), good.clone()]).is_ok());

    let views = backward(&recorded, std::slice::from_ref(&good));
    assert!(matches!(views, Err(Error::Views { expected: 2, found: 1 })), "{views:?}");
    let other = backward(&scene(3, -1.0), &[good.clone(), good.clone()]);
    assert!(matches!(other, Err(Error::OtherScene { expected: 2, found: 3, .. })), "{other:?}");
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut broken = good.clone();
        broken.image.to_mut()[7] = bad;
        let found = backward(&recorded, &[good.clone(), broken]);
        assert!(matches!(found, Err(Error::PixelGradientNotFinite { what: "image", index: 7 })), "{found:?}");
        let broken = PixelGradients { alpha: Some(vec![bad; 200]), ..good.clone() };
        let found = backward(&recorded, &[broken, good.clone()]);
        assert!(matches!(found, Err(Error::PixelGradientNotFinite { what: "alpha", index: 0 })), "{found:?}");
    }
    let short = PixelGradients { image: vec![0.0; 599].into(), ..good.clone() };
    let found = backward(&recorded, &[good.clone(), short]);
    assert!(matches!(found, Err(Error::PixelGradientLength { expected: 600, found: 599, .. })), "{found:?}");
    let by_depth = PixelGradients { depth: Some(vec![0.0; 200]), ..good.clone() };
    let found = backward(&recorded, &[by_depth, good]);
    assert!(matches!(found, Err(Error::DepthNotRendered)), "{found:?}");
}

#[test]
#[ignore = "gpu"]
fn huge_pixel_gradients_give_finite_gradients() {
    let (scene, camera) = (scene(300, -1.0), camera(20, 10));
    let mut gpu = gpu();
    // Sums over many Gaussians and two views leave the range of f32, too.
    let (_, tape) = gpu.record(&scene, &[camera, camera], &RenderSettings::default()).expect("valid");
    for value in [f32::MAX, -f32::MAX, 1e37, 1e36, 1e30, 1e-40] {
        let loss =
            PixelGradients { image: vec![value; 600].into(), alpha: Some(vec![-value; 200]), depth: None };
        let gradients = gpu.backward(&scene, &tape, &[loss.clone(), loss]).expect("valid");
        assert!(gradients.geometry.iter().chain(&gradients.sh).all(|value| value.is_finite()), "{value}");
        let pose = gradients.cameras[0];
        assert!(pose.rotation.is_finite() && pose.translation.is_finite(), "{value}");
        assert!(pose.focal.is_finite(), "{value}");
        assert!(gradients.background.iter().all(|value| value.is_finite()), "{value}");
    }
}

#[test]
#[ignore = "gpu"]
fn a_tape_of_another_device() {
    let (scene, camera) = (scene(2, -1.0), camera(20, 10));
    let settings = RenderSettings::default();
    let (_, tape) = Rasterizer::cpu().record(&scene, &[camera], &settings).expect("valid");
    let found = gpu().backward(&scene, &tape, &[loss(&camera)]);
    assert!(matches!(found, Err(Error::OtherDevice)), "{found:?}");
    let (_, tape) = another_gpu().record(&scene, &[camera], &settings).expect("valid");
    let found = gpu().backward(&scene, &tape, &[loss(&camera)]);
    assert!(matches!(found, Err(Error::OtherDevice)), "{found:?}");
}

#[test]
#[ignore = "gpu"]
fn settings_out_of_range() {
    let (scene, camera) = (scene(2, -1.0), camera(20, 10));
    let settings = RenderSettings { near: f32::NAN, ..RenderSettings::default() };
    let found = gpu().render(&scene, &camera, &settings);
    assert!(matches!(found, Err(Error::Setting { name: "near", .. })));
}
