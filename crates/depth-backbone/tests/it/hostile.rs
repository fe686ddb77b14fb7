use crate::{COURTYARD, LENS, camera_at, check_geometry, depths, flat, known, photograph, sweep};
use depth_backbone::{DepthBackbone, DepthRange, Error, PlaneSweep, ViewGeometry, Wanted};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, View};
use scene_sim::{Traced, demo_scene, lens};

const KNOWN: DepthRange = DepthRange::Known { near: 2.0, far: 8.0 };

/// Every entry point must refuse the input with an error that `expected` accepts.
fn check_error(sweep: &PlaneSweep, views: &[View], expected: impl Fn(&Error) -> bool) {
    match sweep.estimate(views, Wanted::Depth) {
        Ok(_) => panic!("a result, expected an error"),
        Err(error) => assert!(expected(&error), "{error}"),
    }
}

/// A result that keeps the promises, in a known range; in an unknown one that, or an error that says so.
fn check_defined(views: &[View]) {
    depths(&sweep(KNOWN), views);
    match PlaneSweep::default().estimate(views, Wanted::DepthAndFeatures) {
        Ok(geometry) => {
            check_geometry(views, &geometry);
            for (geometry, view) in geometry.iter().zip(views) {
                let features = geometry.feature_map(view).unwrap().unwrap();
                assert!(features.data().iter().all(|v| v.is_finite()));
            }
        }
        Err(error) => assert!(matches!(error, Error::RangeUnknown { .. }), "{error}"),
    }
}

#[test]
fn too_few_views() {
    for range in [KNOWN, DepthRange::Estimate] {
        check_error(&sweep(range), &[], |e| matches!(e, Error::NoViews));
        check_error(&sweep(range), &COURTYARD[..1], |e| matches!(e, Error::OneView));
        assert!(matches!(sweep(range).depth_range(&[]), Err(Error::NoViews)));
        assert!(matches!(sweep(range).depth_range(&COURTYARD[..1]), Err(Error::OneView)));
    }
}

#[test]
fn a_pixel_that_is_not_finite_is_named() {
    for (channel, value) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().enumerate() {
        let mut views = COURTYARD[..3].to_vec();
        views[2].image_mut().data_mut()[(71 * 160 + 33) * 3 + channel] = value;
        for range in [KNOWN, DepthRange::Estimate] {
            check_error(
                &sweep(range),
                &views,
                |e| matches!(e, Error::PixelNotFinite { view, x: 33, y: 71 } if view == "photograph 2"),
            );
        }
    }
}

#[test]
fn a_range_that_is_none() {
    let nan = f64::NAN;
    for (near, far) in
        [(4.0, 2.0), (3.0, 3.0), (0.0, 2.0), (-1.0, 2.0), (nan, 2.0), (1.0, nan), (1.0, f64::INFINITY)]
    {
        check_error(&sweep(DepthRange::Known { near, far }), &COURTYARD[..2], |e| {
            matches!(e, Error::Range { .. })
        });
    }
}

#[test]
fn settings_out_of_range() {
    let views = &COURTYARD[..2];
    for planes in [0, 1] {
        check_error(
            &PlaneSweep { planes, ..known(views) },
            views,
            |e| matches!(e, Error::Setting { setting: "planes", found, .. } if *found == planes as f64),
        );
    }
    check_error(&PlaneSweep { sources: 0, ..known(views) }, views, |e| {
        matches!(e, Error::Setting { setting: "sources", found: 0.0, .. })
    });
    // The smallest and largest that are in range.
    depths(&PlaneSweep { planes: 2, sources: 1, ..known(views) }, views);
    depths(&PlaneSweep { sources: usize::MAX, ..known(views) }, views);
}

#[test]
fn pictures_of_one_colour() {
    for grey in [0.0, 0.4, 1.0] {
        let views: Vec<View> =
            (0..3).map(|i| flat(&i.to_string(), camera_at(0.2 * f64::from(i)), grey)).collect();
        check_defined(&views);
        let error = PlaneSweep::default().estimate(&views, Wanted::Depth).err();
        assert!(matches!(error, Some(Error::RangeUnknown { .. })), "grey {grey}: {error:?}");
        for geometry in depths(&sweep(KNOWN), &views) {
            assert!(geometry.confidence.iter().all(|&c| c < 0.5), "nothing confirms a depth without texture");
        }
    }
}

#[test]
fn one_black_view_among_good_ones() {
    let mut views = COURTYARD[..4].to_vec();
    views[1].image_mut().data_mut().fill(0.0);
    let geometry = depths(&known(&COURTYARD), &views);
    assert!(geometry[1].confidence.iter().all(|&c| c < 0.5));
    let confident = geometry[0].confidence.iter().filter(|&&c| c >= 0.5).count();
    assert!(confident * 5 > geometry[0].confidence.len(), "the others do not suffer: {confident} pixels");
}

#[test]
fn pixels_far_beyond_white_and_below_black() {
    let mut views = COURTYARD[..2].to_vec();
    for (i, value) in views[0].image_mut().data_mut().iter_mut().enumerate() {
        *value = if i % 2 == 0 { f32::MAX } else { f32::MIN };
    }
    depths(&known(&COURTYARD), &views);
}

#[test]
fn all_cameras_in_one_place_leave_the_range_unknown_and_confirm_nothing() {
    let scene = Traced::new(&demo_scene()).unwrap();
    for place in [DVec3::ZERO, DVec3::new(0.3, -0.7, 1.1)] {
        let turned = |i: u8| {
            let rotation = DMat3::from_rotation_y(0.1 * f64::from(i));
            Camera::new(LENS, rotation, -(rotation * place)).unwrap()
        };
        let views = photograph(&scene, &[turned(0), turned(1), turned(2), turned(0)]);
        check_error(&PlaneSweep::default(), &views, |e| matches!(e, Error::RangeUnknown { .. }));
        for geometry in depths(&sweep(KNOWN), &views) {
            assert!(geometry.confidence.iter().all(|&c| c < 0.5), "nothing is seen from elsewhere");
        }
    }
}

#[test]
fn a_view_given_twice_changes_little_and_confirms_nothing() {
    let once = depths(&known(&COURTYARD), &COURTYARD[..3]);
    let views = [&COURTYARD[..3], &COURTYARD[..1]].concat();
    let geometry = depths(&known(&COURTYARD), &views);
    let twins = geometry[0].depth.data().iter().zip(geometry[3].depth.data());
    let alike = twins.filter(|(a, b)| (**a / **b - 1.0).abs() < 1e-3).count();
    assert!(alike * 100 >= geometry[0].depth.data().len() * 99, "{alike} pixels alike");
    let confident = |g: &ViewGeometry| g.confidence.iter().filter(|&&c| c >= 0.5).count();
    let (before, after) = (confident(&once[0]), confident(&geometry[0]));
    assert!(after as f64 <= 1.02 * before as f64, "{before} confident pixels, {after} with a twin");
}

#[test]
fn views_that_share_nothing() {
    let away = |degrees: f64| {
        let rotation = DMat3::from_rotation_y(degrees.to_radians());
        Camera::new(LENS, rotation, rotation * DVec3::new(0.3 * degrees, 0.0, 0.0)).unwrap()
    };
    let scene = Traced::new(&demo_scene()).unwrap();
    let views = photograph(&scene, &[away(0.0), away(120.0), away(240.0)]);
    check_error(&PlaneSweep::default(), &views, |e| matches!(e, Error::RangeUnknown { .. }));
    for geometry in depths(&sweep(KNOWN), &views) {
        assert!(geometry.confidence.iter().all(|&c| c < 0.5), "nothing can be confirmed");
    }
}

#[test]
fn sizes_that_fit_no_block_and_single_pixels() {
    let scene = Traced::new(&demo_scene()).unwrap();
    for (width, height) in [(33, 17), (31, 65), (1, 40), (40, 1), (2, 2), (1, 1)] {
        let resize = |view: &View| view.camera().with_intrinsics(lens(width, height, 62.0)).unwrap();
        let cameras: Vec<Camera> = COURTYARD[..3].iter().map(resize).collect();
        check_defined(&photograph(&scene, &cameras));
    }
}

#[test]
fn one_view_of_a_single_pixel_among_others() {
    let scene = Traced::new(&demo_scene()).unwrap();
    let tiny = COURTYARD[1].camera().with_intrinsics(lens(1, 1, 62.0)).unwrap();
    let mut views = COURTYARD[..3].to_vec();
    views[1] = photograph(&scene, &[tiny]).remove(0);
    check_defined(&views);
}
