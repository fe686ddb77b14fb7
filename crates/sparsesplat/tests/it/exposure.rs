use crate::{COURTYARD, draw, given_depth, psnr, run};
use gs_scene::View;
use sparsesplat::{Config, Exposure, ExposureGain};

fn expose(view: &mut View, gain: f32, bias: f32) {
    view.image_mut().data_mut().iter_mut().for_each(|value| *value = (gain * *value + bias).clamp(0.0, 1.0));
}

/// The views, one of them taken with another exposure.
fn with_exposure(index: usize, gain: f32, bias: f32) -> Vec<View> {
    let mut views = COURTYARD.0.clone();
    expose(&mut views[index], gain, bias);
    views
}

/// Views that become lighter along the path; the first is at a step of it, the others two steps on each.
fn along_the_path(views: &[View], first: usize) -> Vec<View> {
    let mut views = views.to_vec();
    views.iter_mut().enumerate().for_each(|(i, view)| expose(view, 0.8 + 0.06 * (first + 2 * i) as f32, 0.0));
    views
}

/// The ratio of the gains must be the change's within a few percent, and no grey of the scene may differ between the
/// changed view and another by more than a quarter of what it did. The estimate is drawn weakly towards no change.
fn check(index: usize, gain: f32, bias: f32) {
    const GREYS: [f32; 3] = [0.2, 0.5, 0.7];
    let prediction = run(&with_exposure(index, gain, bias), &given_depth(2_000));
    let exposure = &prediction.exposure;
    let mean = exposure.iter().map(|e| e.gain).sum::<f32>() / exposure.len() as f32;
    assert!((mean - 1.0).abs() < 1e-5, "mean gain {mean}");
    let changed = exposure[index];
    let largest = |of: &dyn Fn(f32) -> f32| GREYS.map(of).into_iter().fold(0.0, f32::max);
    let before = largest(&|grey| (gain * grey + bias - grey).abs());
    for (i, other) in exposure.iter().enumerate().filter(|(i, _)| *i != index) {
        let ratio = other.gain / changed.gain;
        assert!((ratio - gain).abs() < 0.05, "view {i}: gain ratio {ratio}, expected {gain}");
        let brought = |e: ExposureGain, value: f32| e.gain * value + e.bias;
        let after = largest(&|grey| (brought(*other, grey) - brought(changed, gain * grey + bias)).abs());
        assert!(after < 0.25 * before, "view {i}: greys differ by {after}, by {before} before");
    }
}

#[test]
fn gain_and_bias_of_one_view_are_found() {
    check(1, 1.2, -0.05);
    check(2, 0.8, 0.0);
    check(0, 1.0, -0.1);
    // Middle grey stays where it is; dark and light ones do not.
    check(1, 0.8, 0.1);
}

#[test]
fn views_of_one_exposure_are_left_as_they_are() {
    assert_eq!(run(&COURTYARD.0, &given_depth(2_000)).exposure, [ExposureGain::NONE; 4]);
    // One change for all is no difference between them.
    let mut views = COURTYARD.0.clone();
    views.iter_mut().for_each(|view| expose(view, 0.5, 0.2));
    assert_eq!(run(&views, &given_depth(2_000)).exposure, [ExposureGain::NONE; 4]);
}

#[test]
fn views_without_anything_in_common_are_left_as_they_are() {
    assert_eq!(run(&with_exposure(0, 0.5, 0.3)[..1], &given_depth(500)).exposure, [ExposureGain::NONE]);
    assert_eq!(run(&with_exposure(1, 0.0, 0.0)[..2], &given_depth(500)).exposure, [ExposureGain::NONE; 2]);
}

#[test]
fn a_scene_may_be_in_the_common_exposure() {
    // The others' mean gain makes up for the changed view's; a target in that exposure is met as well as before.
    let views = with_exposure(1, 1.2, -0.05);
    let prediction = run(&views, &Config { exposure: Exposure::Common, ..given_depth(8_000) });
    let common = prediction.exposure[0];
    let mut targets = COURTYARD.1.clone();
    targets.iter_mut().for_each(|target| expose(target, common.gain, common.bias));
    let (found, before) =
        (psnr(&prediction, &targets), psnr(&run(&COURTYARD.0, &given_depth(8_000)), &COURTYARD.1));
    assert!(found > before - 0.7, "{found:.2} dB, {before:.2} dB where all views have one exposure");
}

#[test]
fn a_scene_as_photographed_has_the_exposure_of_where_it_is_seen_from() {
    // Along the path photographs become lighter; those between two of them, and their own, must be met with nothing known of theirs.
    let (context, targets) = (along_the_path(&COURTYARD.0, 0), along_the_path(&COURTYARD.1, 1));
    let of = |exposure| run(&context, &Config { exposure, ..given_depth(8_000) });
    let (followed, common) = (of(Exposure::AsPhotographed), of(Exposure::Common));
    let ideal = run(&COURTYARD.0, &given_depth(8_000));
    for (which, seen, unchanged) in [("held-out", &targets, &COURTYARD.1), ("own", &context, &COURTYARD.0)] {
        let (followed, common) = (psnr(&followed, seen), psnr(&common, seen));
        let ideal = psnr(&ideal, unchanged);
        // More than half of what one exposure loses is won back.
        assert!(
            followed > 0.5 * (common + ideal),
            "{which} views: {followed:.2} dB, {common:.2} in one exposure, {ideal:.2} where all have one"
        );
    }
}

#[test]
fn looks_follow_the_exposures_of_a_scene_as_photographed() {
    // Looks that fitted a gain and a bias to each view would draw the scene back to one exposure: the photographs' light is off by 0.061 (mean
    // logarithm) after the head, by 0.041 after the looks, and with such a fit by 0.049.
    let views = along_the_path(&COURTYARD.0, 0);
    let off = |looks| {
        let prediction = run(&views, &Config { looks, ..given_depth(4_000) });
        let sum = |values: &[f32]| values.iter().map(|value| f64::from(*value)).sum::<f64>();
        let of = |view: &View| (sum(view.image().data()) / sum(draw(&prediction, view).data())).ln().abs();
        views.iter().map(of).sum::<f64>() / views.len() as f64
    };
    let (head, looked) = (off(1), off(4));
    assert!(looked < 0.73 * head, "light is off by {head:.4} after the head, {looked:.4} after looks");
}
