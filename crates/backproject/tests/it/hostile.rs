use crate::{LENS, PIXELS, anchors_of, camera, every_pixel, view};
use backproject::{Backprojected, Dropped, Settings, ViewPixels, anchors};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, FeatureMap, Image, Intrinsics};

#[test]
fn nothing_in_gives_nothing_out() {
    assert_eq!(anchors(&[], &Settings::default()).unwrap(), Backprojected::default());
    let (camera, depth) = (camera(), vec![1.0; PIXELS]);
    let found = anchors_of(view(&camera, &depth, &[]));
    assert!(found.anchors.is_empty());
    assert!(found.ranges.len() == 1 && found.ranges[0].is_empty());
    assert_eq!(found.dropped, [Dropped::default()]);
}

#[test]
fn views_without_any_depth_are_all_counted() {
    let camera = camera();
    let pixels = every_pixel();
    for (depth, reason) in [(0.0, "no"), (f32::NAN, "not"), (f32::INFINITY, "not"), (-2.0, "negative")] {
        let found = anchors_of(view(&camera, &[depth; PIXELS], &pixels));
        let Dropped { no_depth, not_finite, negative, .. } = found.dropped[0];
        let counted = match reason {
            "no" => no_depth,
            "not" => not_finite,
            _ => negative,
        };
        assert_eq!((counted, found.anchors.len()), (PIXELS, 0), "{depth}");
    }
}

#[test]
fn any_depth_above_zero_is_lifted() {
    let camera = camera();
    for z in [f32::from_bits(1), f32::MIN_POSITIVE, 1e-20, 1e20, f32::MAX] {
        let found = anchors_of(view(&camera, &[z; PIXELS], &[0, 615])).anchors;
        assert_eq!((found.len(), &found.depths), (2, &vec![z; 2]));
        for i in 0..2 {
            let [x, y, depth] = found.positions[i];
            assert!(x.is_finite() && y.is_finite() && depth == f64::from(z));
            assert_eq!(found.normals[i], [0.0, 0.0, -1.0], "{z}");
            assert!(found.footprints[i].is_finite());
        }
    }
}

#[test]
fn sizes_that_do_not_fit_are_refused_by_name() {
    let (camera, depth) = (camera(), vec![1.0; PIXELS]);
    let good = view(&camera, &depth, &[1]);
    let image = Image::filled(40, 30, [0.5; 3]).unwrap();
    let turned = Image::filled(30, 40, [0.5; 3]).unwrap();
    let map = |channels| FeatureMap::new(channels, 4, 3, vec![0.0; channels * 12]).unwrap();
    let (two, three) = (map(2), map(3));
    let text = |views: &[ViewPixels]| anchors(views, &Settings::default()).unwrap_err().to_string();

    let short = ViewPixels { depth: &depth[1..], ..good };
    assert_eq!(text(&[good, short]), "depth of view 1 holds 1199 numbers, its camera has 40x30 pixels");
    let outside = ViewPixels { pixels: &[3, 1200, u32::MAX], ..good };
    assert_eq!(text(&[good, outside]), "pixel 1200 of view 1 is outside the image of 1200 pixels");
    let far_outside: Vec<u32> = (1200..9000).collect();
    let outside = ViewPixels { pixels: &far_outside, ..good };
    assert_eq!(text(&[outside; 3]), "pixel 1200 of view 0 is outside the image of 1200 pixels");
    let wrong = ViewPixels { image: Some(&turned), ..good };
    assert_eq!(text(&[wrong]), "image of view 0 is 30x40, its camera is 40x30");
    let coloured = ViewPixels { image: Some(&image), ..good };
    let rule =
        "view 1 differs from view 0 in having an image or not, expected an image for all views or none";
    assert_eq!(text(&[coloured, good]), rule);
    assert_eq!(text(&[good, coloured]), rule);
    let [two, three] = [&two, &three].map(|map| ViewPixels { features: Some(map), ..good });
    assert_eq!(text(&[two, three]), "features of view 1 have 3 channels, those of view 0 have 2");
    assert_eq!(
        text(&[two, two, good]),
        "view 2 differs from view 0 in having features or not, expected features for all views or none"
    );
}

#[test]
fn cameras_beyond_f64_are_refused() {
    let depth = vec![1.0; PIXELS];
    for lens in [
        Intrinsics { fx: 1e-300, ..LENS },
        Intrinsics { cx: 1e300, ..LENS },
        Intrinsics { fx: 1e300, fy: 1e300, ..LENS },
    ] {
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let refused = anchors(&[view(&camera, &depth, &[0])], &Settings::default()).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "camera of view 0 puts points of depth up to 3.4e38 beyond the range of f64"
        );
    }
    // Just a strange lens.
    let lens = Intrinsics { fx: 1e-6, fy: 1e-6, ..LENS };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
    let found = anchors_of(view(&camera, &[f32::MAX; PIXELS], &[0])).anchors;
    assert_eq!(found.footprints, [f32::MAX]);
}

#[test]
fn a_farthest_depth_that_is_none_is_refused() {
    for far in [f32::NAN, 0.0, -1.0] {
        let refused = anchors(&[], &Settings { far, ..Settings::default() }).unwrap_err();
        let expected = format!("farthest depth is {far}, expected a number above 0 (infinity for no limit)");
        assert_eq!(refused.to_string(), expected);
    }
}
