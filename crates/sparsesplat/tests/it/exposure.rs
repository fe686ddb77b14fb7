use crate::{COURTYARD, given_depth, psnr, run};
use gs_scene::View;
use sparsesplat::ExposureGain;

const NEUTRAL: ExposureGain = ExposureGain { gain: 1.0, bias: 0.0 };

/// The views, one of them taken with another exposure.
fn with_exposure(index: usize, gain: f32, bias: f32) -> Vec<View> {
    let mut views = COURTYARD.0.clone();
    for value in views[index].image_mut().data_mut() {
        *value = (gain * *value + bias).clamp(0.0, 1.0);
    }
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
    assert_eq!(run(&COURTYARD.0, &given_depth(2_000)).exposure, [NEUTRAL; 4]);
    // One change for all is no difference between them.
    let mut views = COURTYARD.0.clone();
    for view in &mut views {
        view.image_mut().data_mut().iter_mut().for_each(|value| *value = 0.5 * *value + 0.2);
    }
    assert_eq!(run(&views, &given_depth(2_000)).exposure, [NEUTRAL; 4]);
}

#[test]
fn views_without_anything_in_common_are_left_as_they_are() {
    assert_eq!(run(&with_exposure(0, 0.5, 0.3)[..1], &given_depth(500)).exposure, [NEUTRAL]);
    assert_eq!(run(&with_exposure(1, 0.0, 0.0)[..2], &given_depth(500)).exposure, [NEUTRAL; 2]);
}

#[test]
fn the_scene_is_in_the_common_exposure() {
    // The others' mean gain makes up for the changed view's; a target in that exposure is met as well as before.
    let views = with_exposure(1, 1.2, -0.05);
    let prediction = run(&views, &given_depth(8_000));
    let common = prediction.exposure[0];
    let mut targets = COURTYARD.1.clone();
    for value in targets.iter_mut().flat_map(|target| target.image_mut().data_mut()) {
        *value = common.gain * *value + common.bias;
    }
    let (found, before) =
        (psnr(&prediction, &targets), psnr(&run(&COURTYARD.0, &given_depth(8_000)), &COURTYARD.1));
    assert!(found > before - 0.7, "{found:.2} dB, {before:.2} dB where all views have one exposure");
}
