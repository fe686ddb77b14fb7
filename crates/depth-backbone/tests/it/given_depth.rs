use crate::{COURTYARD, check_geometry, with_depth};
use depth_backbone::{DepthBackbone, Error, FEATURE_NAMES, GivenDepth, Wanted};
use gs_scene::View;

#[test]
fn depth_is_passed_on_and_confidence_marks_what_was_measured() {
    let mut data = COURTYARD[0].depth().unwrap().data().to_vec();
    data[..40].fill(0.0);
    data[40..60].fill(f32::NAN);
    let views = [with_depth(&COURTYARD[0], Some(data)), COURTYARD[1].clone()];
    let geometry = GivenDepth.estimate(&views, Wanted::DepthAndFeatures).unwrap();
    check_geometry(&views, &geometry);
    for (view, geometry) in views.iter().zip(&geometry) {
        assert_eq!(&geometry.depth, view.depth().unwrap());
        for (depth, confidence) in geometry.depth.data().iter().zip(&geometry.confidence) {
            assert_eq!(*confidence, f32::from(u8::from(*depth > 0.0)));
        }
        let features = geometry.feature_map(view).unwrap().unwrap();
        assert_eq!(features.channels(), FEATURE_NAMES.len());
        assert!(features.data().iter().all(|v| v.is_finite()));
    }
    assert!(geometry[0].confidence[..60].iter().all(|&c| c == 0.0));
    assert!(GivenDepth.estimate(&views, Wanted::Depth).unwrap().iter().all(|g| g.features.is_none()));
}

#[test]
fn one_view_suffices_and_none_is_an_error() {
    assert_eq!(GivenDepth.estimate(&COURTYARD[..1], Wanted::Depth).unwrap().len(), 1);
    assert!(matches!(GivenDepth.estimate(&[], Wanted::Depth), Err(Error::NoViews)));
}

#[test]
fn the_view_without_depth_is_named() {
    let views = [COURTYARD[0].clone(), with_depth(&COURTYARD[1], None)];
    let named =
        |error: Option<Error>| matches!(error, Some(Error::NoDepth { view }) if view == "photograph 1");
    assert!(named(GivenDepth.estimate(&views, Wanted::Depth).err()));
    assert!(named(GivenDepth::depth_range(&views).err()));
}

#[test]
fn a_pixel_that_is_no_number_is_named() {
    let mut views = COURTYARD[..2].to_vec();
    let width = views[1].image().width();
    views[1].image_mut().data_mut()[3 * (2 * width + 5) + 1] = f32::NAN;
    let error = GivenDepth.estimate(&views, Wanted::Depth).err();
    assert!(matches!(error, Some(Error::PixelNotFinite { x: 5, y: 2, .. })), "{error:?}");
}

#[test]
fn the_range_holds_all_but_half_a_percent_at_either_end() {
    let n = COURTYARD[0].depth().unwrap().data().len();
    let ramp = with_depth(&COURTYARD[0], Some((1..=n).map(|i| i as f32).collect()));
    let (near, far) = GivenDepth::depth_range(&[ramp]).unwrap();
    assert!((near / (0.005 * n as f64) - 1.0).abs() < 0.02, "{near}");
    assert!((far / (0.995 * n as f64) - 1.0).abs() < 0.001, "{far}");
}

#[test]
fn nothing_measured_has_no_range() {
    let empty = |view: &View| with_depth(view, Some(vec![0.0; view.depth().unwrap().data().len()]));
    let views: Vec<View> = COURTYARD[..2].iter().map(empty).collect();
    assert!(matches!(GivenDepth::depth_range(&views), Err(Error::NothingMeasured)));
    let geometry = GivenDepth.estimate(&views, Wanted::DepthAndFeatures).unwrap();
    for (geometry, view) in geometry.iter().zip(&views) {
        assert_eq!(geometry.depth.coverage(), 0.0);
        assert!(geometry.confidence.iter().all(|&c| c == 0.0));
        let features = geometry.feature_map(view).unwrap().unwrap();
        assert!(features.data().iter().all(|v| v.is_finite()));
    }
}
