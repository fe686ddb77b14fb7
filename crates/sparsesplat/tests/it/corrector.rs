use super::*;
use attn_head::Weights;
use sparsesplat::learned::{Corrector, FEATURES, corrector_features, image_features};
use sparsesplat::{Allocation, Correction, Error, Head};

/// For a scene that is refined before it is corrected.
fn refined_later(gaussians: usize) -> Config {
    Config { refined_later: true, ..plane_sweep(gaussians) }
}

/// With the default looks.
fn passing(gaussians: usize) -> Config {
    Config { looks: Config::default().looks, ..plane_sweep(gaussians) }
}

/// The prediction, what corrects it, and the Gaussians after some steps.
fn refined(config: &Config, steps: usize) -> (Prediction, Corrector, Gaussians) {
    let views = &COURTYARD.0;
    let mut prediction = run(views, config);
    let corrector = prediction.corrector.take().unwrap();
    let stop = refine::Stop::Steps(steps);
    let settings = refine::Config { stop, prune: false, exposure: false, ..refine::Config::default() };
    let scene = prediction.gaussians.clone();
    let refined = refine::refine(scene, views, &settings, &mut Rasterizer::cpu(), &mut |_| {}).unwrap();
    (prediction, corrector, refined.gaussians)
}

/// Mean PSNR of the held-out views, dB.
fn held_out(gaussians: &Gaussians, prediction: &Prediction) -> f64 {
    let scene = Prediction { gaussians: gaussians.clone(), ..prediction.clone() };
    let targets = &COURTYARD.1;
    let psnr = |target: &View| image_metrics::psnr(&draw(&scene, target), target.image()).unwrap();
    targets.iter().map(psnr).sum::<f64>() / targets.len() as f64
}

#[test]
fn a_refined_scene_is_better_on_held_out_views_when_it_is_corrected() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    // One draw of pixels gains 0.02 to 0.07 dB.
    let gains = [0, 1, 2, 3].map(|seed| {
        let (prediction, corrector, refined) = refined(&Config { seed, ..refined_later(1500) }, 30);
        let corrected = corrector.clone().corrected(refined.clone(), &COURTYARD.0).unwrap();
        check_gaussians(&corrected, false);
        let anchors = prediction.counts.total - prediction.counts.shell;
        assert_eq!((corrected.len(), corrected.sh_degree()), (refined.len(), 2));
        let rows = Gaussians::GEOMETRY * anchors;
        assert_eq!(corrected.geometry()[rows..], refined.geometry()[rows..], "the shell stays");
        assert_ne!(corrected.geometry()[..rows], refined.geometry()[..rows]);
        let [before, after] = [&refined, &corrected].map(|scene| held_out(scene, &prediction));
        // It is the same on one thread.
        if seed == 0 {
            assert_eq!(pool.install(|| corrector.corrected(refined, &COURTYARD.0)).unwrap(), corrected);
        }
        after - before
    });
    assert!(gains.iter().sum::<f64>() > 0.03 * gains.len() as f64, "{gains:?}");
}

#[test]
fn the_pass_corrects_its_scene_itself_where_nothing_refines_it() {
    let views = &COURTYARD.0;
    let passed = run(views, &passing(1500));
    let by = passed.corrected_by.as_deref().unwrap();
    assert!(by.contains("refined-grid") && passed.corrector.is_none(), "{by}");
    assert!(passed.seconds[Stage::Correction] > 0.0);
    let before = run(views, &Config { refined_later: true, ..passing(1500) });
    assert!(before.corrected_by.is_none() && before.seconds[Stage::Correction] == 0.0);
    assert_eq!(
        before.corrector.unwrap().corrected(before.gaussians.clone(), views).unwrap(),
        passed.gaussians
    );
    let off = Config { correction: Correction::Off, ..passing(1500) };
    let uncorrected = run(views, &off);
    assert_eq!((&uncorrected.gaussians, &uncorrected.corrected_by), (&before.gaussians, &None));
    let [before, after] = [&uncorrected, &passed].map(|made| held_out(&made.gaussians, &passed));
    assert!(after > before, "{before} {after}");
    // A single look, or no weights, is what was asked for.
    for config in [plane_sweep(600), Config { head: Head::ClosedForm, ..passing(600) }] {
        assert!(run(views, &config).corrected_by.is_none());
    }
    // In one exposure, the photographs are corrected in it.
    let mut views = views.clone();
    views[1].image_mut().data_mut().iter_mut().for_each(|value| *value *= 0.7);
    let common = |config: Config| run(&views, &Config { exposure: Exposure::Common, ..config });
    let (passed, before) = (common(passing(600)), common(Config { refined_later: true, ..passing(600) }));
    let exposed = Exposure::Common.views(&views, &before.exposure);
    assert_ne!(exposed[1].image(), views[1].image());
    assert_eq!(before.corrector.unwrap().corrected(before.gaussians, &exposed).unwrap(), passed.gaussians);
}

#[test]
fn one_without_training_leaves_the_scene_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("untrained.safetensors");
    let image = image_features(depth_backbone::FEATURE_NAMES.len());
    let kind = attn_head::Kind::Grid;
    let config = attn_head::Config { kind, geometry: corrector_features(), image, neighbours: 20 };
    let features = (FEATURES.to_owned(), depth_backbone::PlaneSweep::SCHEMA.to_owned());
    Weights { metadata: [features].into(), ..Weights::initial(config, 0).unwrap() }.write(&path).unwrap();
    let config = Config { correction: Correction::Weights(path), ..refined_later(800) };
    // After a single look too, where it is named.
    let passed = run(&COURTYARD.0, &Config { refined_later: false, ..config.clone() });
    let off = run(&COURTYARD.0, &Config { correction: Correction::Off, ..plane_sweep(800) });
    assert!(passed.corrected_by.is_some() && off.corrected_by.is_none());
    assert_eq!(passed.gaussians, off.gaussians);
    for exposure in [Exposure::AsPhotographed, Exposure::Common] {
        let (_, corrector, refined) = refined(&Config { exposure, ..config.clone() }, 2);
        assert_eq!(corrector.clone().corrected(refined.clone(), &COURTYARD.0).unwrap(), refined);
        assert!(corrector.name().ends_with("untrained.safetensors"));
    }
    // The closed form has no features of its own to look at: the backbone is asked for them.
    let closed = Config { head: Head::ClosedForm, ..config };
    let (_, corrector, refined) = refined(&closed, 1);
    let same = corrector.clone().corrected(refined.clone(), &COURTYARD.0).unwrap();
    assert_eq!(same, refined.with_sh_degree(2).unwrap());
}

#[test]
fn photographs_of_other_exposures_and_moved_cameras_are_corrected_as_well() {
    let mut views = COURTYARD.0.clone();
    views[1].image_mut().data_mut().iter_mut().for_each(|value| *value *= 0.7);
    let prediction = predict(&views, &refined_later(1500)).unwrap();
    assert!(prediction.exposure.iter().any(|&view| view != ExposureGain::NONE));
    let corrector = prediction.corrector.clone().unwrap();
    let settings = refine::Config {
        stop: refine::Stop::Steps(20),
        rates: refine::Rates { pose: 0.1, ..refine::Rates::default() },
        prune: false,
        exposure: false,
        ..refine::Config::default()
    };
    let scene = prediction.gaussians.clone();
    let refined = refine::refine(scene, &views, &settings, &mut Rasterizer::cpu(), &mut |_| {}).unwrap();
    let moved = |(view, camera): (&View, &Camera)| {
        View::new(view.name(), view.image().clone(), *camera, None).unwrap()
    };
    let moved: Vec<View> = views.iter().zip(&refined.cameras).map(moved).collect();
    let corrected = corrector.clone().corrected(refined.gaussians.clone(), &moved).unwrap();
    check_gaussians(&corrected, false);
    // The dark photograph stays dark: what is seen from its camera changes by little.
    let shown = |gaussians: &Gaussians| {
        let scene = Prediction { gaussians: gaussians.clone(), ..prediction.clone() };
        image_metrics::psnr(&draw(&scene, &moved[1]), views[1].image()).unwrap()
    };
    let [before, after] = [&refined.gaussians, &corrected].map(shown);
    assert!((before - after).abs() < 2.5, "{before} {after}");
    assert_ne!(corrected, corrector.clone().corrected(refined.gaussians, &views).unwrap(), "cameras count");
    // A degree that no head makes.
    let richer = corrected.with_sh_degree(3).unwrap();
    let error = corrector.corrected(richer, &moved).unwrap_err();
    assert!(matches!(error, Error::CorrectedColours { found: 3 }), "{error}");
}

#[test]
fn values_that_are_not_finite_do_not_spread() {
    let (_, corrector, mut refined) = refined(&refined_later(600), 1);
    refined.buffers_mut().0[..Gaussians::GEOMETRY].fill(f32::NAN);
    refined.buffers_mut().0[Gaussians::GEOMETRY] = f32::INFINITY;
    let corrected = corrector.corrected(refined, &COURTYARD.0).unwrap();
    let (rows, sh) = (&corrected.geometry()[2 * Gaussians::GEOMETRY..], &corrected.sh()[2 * 27..]);
    assert!(rows.iter().chain(sh).all(|v| v.is_finite()));
}

#[test]
fn where_gaussians_have_no_anchors_there_is_none() {
    assert!(run(&COURTYARD.0, &passing(500)).corrected_by.is_some());
    let merged = Config { allocation: Allocation::Merged, ..passing(500) };
    assert!(run(&COURTYARD.0, &merged).corrected_by.is_none());
    let measured = Config { looks: Config::default().looks, ..given_depth(500) };
    assert!(run(&COURTYARD.0, &measured).corrected_by.is_none(), "it was trained on stereo");
    let named = Config { correction: Correction::Weights("w".into()), ..merged };
    assert!(matches!(predict(&COURTYARD.0, &named), Err(Error::NothingToCorrect)));
    let missing =
        Config { correction: Correction::Weights("missing.safetensors".into()), ..given_depth(500) };
    let error = predict(&COURTYARD.0, &missing).unwrap_err().to_string();
    assert!(error.contains("missing.safetensors"), "{error}");
}
