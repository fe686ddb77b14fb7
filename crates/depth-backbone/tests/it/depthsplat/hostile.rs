use depth_backbone::{
    DepthBackbone, DepthRange, DepthSplat, Error, GivenDepth, PlaneSweep, Scales, Variant, ViewGeometry, Vit,
    Wanted,
};
use glam::{DMat3, DQuat, DVec3};
use gs_scene::{Camera, Gaussians, Image, Intrinsics, View, sigmoid};
use std::sync::LazyLock;

static NETWORK: LazyLock<DepthSplat> = LazyLock::new(|| {
    let variant = Variant { scales: Scales::Eighth, vit: Vit::Small };
    let range = DepthRange::Known { near: 0.5, far: 50.0 };
    DepthSplat::untrained(variant, "").unwrap().with_range(range)
});

fn view(i: usize, (width, height): (usize, usize), value: impl Fn(usize) -> f32, apart: f64) -> View {
    let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 15.0, cy: 14.0, width, height };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-apart * i as f64, 0.0, 0.0)).unwrap();
    let image = Image::new(width, height, (0..width * height * 3).map(value).collect()).unwrap();
    View::new(format!("picture {i}"), image, camera, None).unwrap()
}

fn views(count: usize, size: (usize, usize)) -> Vec<View> {
    (0..count).map(|i| view(i, size, |k| 0.5 + 0.4 * (k as f32 * 0.07 + i as f32).sin(), 0.2)).collect()
}

/// Depth everywhere within the range, confidence within 0..1, features that are numbers, all at the views' size.
fn check(views: &[View], geometry: &[ViewGeometry]) {
    assert_eq!(views.len(), geometry.len());
    for (view, g) in views.iter().zip(geometry) {
        let (width, height) = (view.image().width(), view.image().height());
        assert_eq!((g.depth.width(), g.depth.height()), (width, height));
        assert!(g.depth.data().iter().all(|d| (0.4999..=50.01).contains(d)));
        assert!(g.confidence.len() == width * height && g.confidence.iter().all(|c| (0.0..=1.0).contains(c)));
        let features = g.feature_map(view).unwrap().unwrap();
        assert_eq!((features.channels(), features.width(), features.height()), (64, width, height));
        assert!(features.data().iter().all(|v| v.is_finite()));
    }
}

#[test]
fn any_size_and_number_of_views() {
    for (count, size) in [(2, (1, 1)), (3, (33, 40)), (12, (32, 32)), (2, (70, 5))] {
        let views = views(count, size);
        check(&views, &NETWORK.estimate(&views, Wanted::DepthAndFeatures).unwrap());
    }
}

#[test]
fn padding_does_not_move_the_picture() {
    // The same picture, once with its last column and row repeated by hand.
    let value = |x: usize, y: usize| 0.5 + 0.4 * (x as f32 * 0.3).sin() * (y as f32 * 0.2).cos();
    let picture = |i, width: usize, height: usize| {
        let at = |k: usize| value((k / 3 % width).min(39), (k / 3 / width).min(29));
        view(i, (width, height), at, 0.2)
    };
    let small = NETWORK.estimate(&[picture(0, 40, 30), picture(1, 40, 30)], Wanted::Depth).unwrap();
    let large = NETWORK.estimate(&[picture(0, 64, 32), picture(1, 64, 32)], Wanted::Depth).unwrap();
    for (small, large) in small.iter().zip(&large) {
        for (i, depth) in small.depth.data().iter().enumerate() {
            assert_eq!(*depth, large.depth.data()[i / 40 * 64 + i % 40]);
        }
    }
}

#[test]
fn too_few_views_and_different_sizes() {
    assert!(matches!(NETWORK.estimate(&[], Wanted::Depth), Err(Error::NoViews)));
    assert!(matches!(NETWORK.estimate(&views(1, (32, 32)), Wanted::Depth), Err(Error::OneView)));
    let mut mixed = views(2, (32, 32));
    mixed.push(views(3, (32, 64)).remove(2));
    let Err(error) = NETWORK.estimate(&mixed, Wanted::Depth) else { panic!("expected an error") };
    assert!(matches!(&error, Error::SizesDiffer { found: (32, 64), first: (32, 32), .. }));
    assert!(error.to_string().contains("picture 2"));
}

#[test]
fn a_pixel_that_is_not_finite_is_named() {
    for value in [f32::NAN, f32::INFINITY] {
        let mut views = views(2, (32, 32));
        views[1].image_mut().data_mut()[(7 * 32 + 9) * 3 + 1] = value;
        let error = NETWORK.estimate(&views, Wanted::Depth).unwrap_err();
        assert!(matches!(error, Error::PixelNotFinite { view, x: 9, y: 7 } if view == "picture 1"));
    }
}

#[test]
fn pictures_without_content_and_cameras_in_one_place() {
    for value in [0.0, 1.0] {
        let flat: Vec<View> = (0..2).map(|i| view(i, (32, 32), |_| value, 0.2)).collect();
        check(&flat, &NETWORK.estimate(&flat, Wanted::DepthAndFeatures).unwrap());
    }
    let heap: Vec<View> = (0..5).map(|i| view(i, (32, 32), |k| (k % 7) as f32 / 7.0, 0.0)).collect();
    check(&heap, &NETWORK.estimate(&heap, Wanted::DepthAndFeatures).unwrap());
    // Far apart: nothing is seen in common.
    let apart: Vec<View> = (0..3).map(|i| view(i, (32, 32), |k| (k % 7) as f32 / 7.0, 1e9)).collect();
    check(&apart, &NETWORK.estimate(&apart, Wanted::DepthAndFeatures).unwrap());
}

#[test]
fn extreme_pixels_give_depth_or_a_named_error() {
    for value in [-1e30, 1e30, f32::MAX] {
        let mut views = views(2, (32, 32));
        views[0].image_mut().data_mut()[100] = value;
        match NETWORK.estimate(&views, Wanted::Depth) {
            Ok(geometry) => assert!(geometry.iter().all(|g| g.depth.coverage() == 1.0)),
            Err(error) => assert!(matches!(error, Error::DepthNotFinite { .. }), "{error}"),
        }
    }
}

#[test]
fn a_range_that_is_none() {
    let views = views(2, (32, 32));
    for (near, far) in [
        (4.0, 2.0),
        (3.0, 3.0),
        (0.0, 2.0),
        (-1.0, 2.0),
        (f64::NAN, 2.0),
        (1.0, f64::INFINITY),
        (1e-300, 1.0),
    ] {
        let ranges = [(0.5, 10.0), (near, far)];
        assert!(matches!(NETWORK.trace(&views, &ranges, false), Err(Error::Range { .. })), "{near} {far}");
    }
    let wrong = NETWORK.trace(&views, &[(0.5, 10.0)], false);
    assert!(matches!(wrong, Err(Error::Setting { setting: "number of ranges", .. })));
}

#[test]
fn one_gaussian_per_pixel() {
    let views = views(2, (40, 30));
    let gaussians = NETWORK.gaussians(&views, &[(0.5, 50.0); 2]).unwrap();
    assert_eq!((gaussians.len(), gaussians.means.len()), (2 * 40 * 30, 2 * 40 * 30 * 3));
    let depth = NETWORK.estimate(&views, Wanted::Depth).unwrap();
    for (i, mean) in gaussians.means.chunks_exact(3).enumerate() {
        let (view, pixel) = (i / 1200, i % 1200);
        let mean = DVec3::new(mean[0].into(), mean[1].into(), mean[2].into());
        let camera = views[view].camera();
        let seen = camera.project(mean).unwrap();
        let (x, y) = ((pixel % 40) as f64, (pixel / 40) as f64);
        assert!((x - 1e-3..=x + 1.001).contains(&seen.x) && (y - 1e-3..=y + 1.001).contains(&seen.y));
        let expected = f64::from(depth[view].depth.data()[pixel]);
        assert!((camera.to_camera(mean).z / expected - 1.0).abs() < 1e-4);
    }
    assert!(gaussians.covariances.iter().chain(&gaussians.harmonics).all(|v| v.is_finite()));
}

#[test]
fn the_set_for_renderers_is_the_same_gaussians() {
    // Cameras that are turned: what is relative to them differs from what is in the world.
    let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 15.0, cy: 14.0, width: 34, height: 30 };
    let turned = |i: usize| {
        let rotation = DMat3::from_axis_angle(DVec3::new(0.3, 1.0, 0.2).normalize(), 0.5 + 0.1 * i as f64);
        let camera = Camera::new(lens, rotation, DVec3::new(0.2 * i as f64, 0.3, 0.0)).unwrap();
        let values = (0..34 * 30 * 3).map(|k| 0.5 + 0.4 * (k as f32 * 0.07 + i as f32).sin()).collect();
        View::new(i.to_string(), Image::new(34, 30, values).unwrap(), camera, None).unwrap()
    };
    let views: Vec<View> = (0..2).map(turned).collect();
    let expected = NETWORK.gaussians(&views, &[(0.5, 50.0); 2]).unwrap();
    let found = NETWORK.estimate(&views, Wanted::DepthAndGaussians).unwrap();
    let mut i = 0;
    for geometry in &found {
        assert!(geometry.features.is_none());
        let set = geometry.gaussians.as_ref().unwrap();
        assert_eq!((set.len(), set.sh_degree()), (34 * 30, 2));
        for (row, sh) in set.geometry().chunks_exact(Gaussians::GEOMETRY).zip(set.sh().chunks_exact(27)) {
            assert_eq!(row[..3], expected.means[3 * i..3 * i + 3]);
            assert!((sigmoid(row[10]) - expected.opacities[i]).abs() < 1e-6);
            let quaternion = DQuat::from_xyzw(row[4].into(), row[5].into(), row[6].into(), row[3].into());
            let deviations = DVec3::new(row[7].into(), row[8].into(), row[9].into()).exp();
            let axes = DMat3::from_quat(quaternion.normalize()) * DMat3::from_diagonal(deviations);
            let covariance = axes * axes.transpose();
            let size = deviations.max_element() * deviations.max_element();
            for (k, &value) in expected.covariances[9 * i..9 * i + 9].iter().enumerate() {
                assert!((covariance.row(k / 3)[k % 3] - f64::from(value)).abs() < 1e-5 * size, "{i}, {k}");
            }
            for (k, &value) in expected.harmonics[27 * i..27 * i + 27].iter().enumerate() {
                assert_eq!(sh[k % 9 * 3 + k / 9], value);
            }
            i += 1;
        }
    }
    assert_eq!(i, expected.len());
}

#[test]
fn backbones_without_a_head_of_their_own_say_so() {
    let views = views(2, (32, 32));
    let range = DepthRange::Known { near: 1.0, far: 9.0 };
    let sweep = PlaneSweep { range, ..PlaneSweep::default() };
    for error in [
        sweep.estimate(&views, Wanted::DepthAndGaussians).unwrap_err(),
        GivenDepth.estimate(&views, Wanted::DepthAndGaussians).unwrap_err(),
    ] {
        assert!(matches!(error, Error::NoOwnHead { .. }), "{error}");
    }
}
