use crate::{COURTYARD, depths, sweep, true_range};
use depth_backbone::{DepthBackbone, DepthRange, PlaneSweep, ViewGeometry, Wanted};
use glam::DVec3;
use gs_scene::{Camera, View};

/// The scene scaled about the origin, then moved.
fn moved(views: &[View], scale: f64, offset: DVec3) -> Vec<View> {
    let move_one = |view: &View| {
        let camera = view.camera();
        let position = camera.position() * scale + offset;
        let camera =
            Camera::new(*camera.intrinsics(), camera.rotation(), -(camera.rotation() * position)).unwrap();
        View::new(view.name(), view.image().clone(), camera, None).unwrap()
    };
    views.iter().map(move_one).collect()
}

const FAR_AWAY: DVec3 = DVec3::new(1e4, -1e4, 1e4);

/// Depth over scale must stay the same where it is confident. Rounding may tip a pixel to another plane, or take the
/// confirmation from a patch that was just large enough.
fn check(scale: f64) {
    let views = &COURTYARD[..3];
    let (near, far) = true_range(views);
    let known = |scale: f64| sweep(DepthRange::Known { near: scale * near, far: scale * far });
    let before = depths(&known(1.0), views);
    let after = depths(&known(scale), &moved(views, scale, FAR_AWAY));
    for (before, after) in before.iter().zip(&after) {
        let confident = |geometry: &ViewGeometry, i: usize| geometry.confidence[i] >= 0.5;
        let pixels = 0..before.confidence.len();
        let one: Vec<usize> =
            pixels.clone().filter(|&i| confident(before, i) || confident(after, i)).collect();
        let both: Vec<usize> = pixels.filter(|&i| confident(before, i) && confident(after, i)).collect();
        assert!(both.len() * 10 >= one.len() * 9, "{} of {} stay confident", both.len(), one.len());
        let ratio = |i: usize| f64::from(after.depth.data()[i]) / scale / f64::from(before.depth.data()[i]);
        let alike = both.iter().filter(|&&i| (ratio(i) - 1.0).abs() < 1e-3).count();
        assert!(alike * 1000 >= both.len() * 998, "{alike} of {} alike at scale {scale}", both.len());
    }
}

#[test]
fn a_large_scene_far_from_the_origin() {
    check(100.0);
}

#[test]
fn a_small_scene_far_from_the_origin() {
    check(0.01);
}

#[test]
fn the_estimated_range_moves_with_the_scene() {
    let views = &COURTYARD[..3];
    let estimate = |views: &[View]| sweep(DepthRange::Estimate).depth_range(views).unwrap();
    let (before, after) = (estimate(views), estimate(&moved(views, 100.0, FAR_AWAY)));
    for (before, after) in [(before.0, after.0), (before.1, after.1)] {
        assert!((after / before - 100.0).abs() < 2.0, "{before} became {after}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let views = &COURTYARD[..2];
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| PlaneSweep::default().estimate(views, Wanted::DepthAndFeatures).unwrap())
    };
    for ((one, two), view) in run(1).iter().zip(&run(2)).zip(views) {
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert!(bits(one.depth.data()) == bits(two.depth.data()));
        assert!(bits(&one.confidence) == bits(&two.confidence));
        let features = |geometry: &ViewGeometry| bits(geometry.feature_map(view).unwrap().unwrap().data());
        assert!(features(one) == features(two));
    }
}
