use super::*;
use scene_sim::Kind;
use scene_windows::SimulatedScene;

fn cases(cache: &Path) -> DepthCases {
    let scenes = [SimulatedScene::Generated(Kind::Room, 2), SimulatedScene::InTheWild(Kind::Desk, 3)];
    let told = std::sync::Mutex::new(Vec::new());
    let cases = DepthCases::open(&scenes, (96, 64), cache, &|name, why| {
        told.lock().unwrap().push((name.to_owned(), why.map(ToString::to_string)));
    });
    let told = told.into_inner().unwrap();
    assert_eq!(told.len(), 2, "{told:?}");
    cases.unwrap()
}

fn config(steps: usize) -> DepthConfig {
    let rates = Rates { learning_rate: 2e-3, warm_up: 2, ..Rates::default() };
    DepthConfig { steps, batch: 2, crop: (24, 16), rates, seed: 5, ..DepthConfig::default() }
}

#[test]
fn a_run_learns_resumes_to_the_bit_and_refuses_checkpoints_of_others() {
    let cache = tempfile::tempdir().unwrap();
    let begin = || DepthTrainer::new(config(12), cases(cache.path())).unwrap();
    let mut whole = begin();
    let records: Vec<DepthRecord> = (0..12).map(|_| whole.step().unwrap()).collect();
    let mean = |records: &[DepthRecord]| records.iter().map(|r| r.loss).sum::<f64>() / records.len() as f64;
    assert!(records.iter().all(|record| record.loss.is_finite() && !record.skipped));
    assert!(mean(&records[8..]) < mean(&records[..4]), "{records:?}");
    assert!(whole.validate(&cases(cache.path())).unwrap().iter().all(|score| score.relative.is_finite()));

    let path = cache.path().join("checkpoint");
    let mut first = begin();
    for _ in 0..5 {
        first.step().unwrap();
    }
    first.save(&path).unwrap();
    let mut second = begin();
    second.resume(&path).unwrap();
    assert_eq!(second.steps(), 5);
    for _ in 5..12 {
        second.step().unwrap();
    }
    assert_eq!(second.weights().values, whole.weights().values);

    let mut other = DepthTrainer::new(config(13), cases(cache.path())).unwrap();
    assert!(matches!(other.resume(&path), Err(Error::OtherRun { what: "configuration", .. })));
    std::fs::write(&path, b"no checkpoint").unwrap();
    assert!(matches!(begin().resume(&path), Err(Error::Checkpoint { .. })));
}

#[test]
fn photographs_without_measured_depth_teach_by_what_they_show_of_each_other() {
    let window = scene_windows::simulated_window(SimulatedScene::Generated(Kind::Desk, 3), (96, 64)).unwrap();
    let trainer = |photometric: f32, agreement: f32| {
        let config = DepthConfig { batch: 1, photometric, agreement, ..config(2) };
        let cases = DepthCases::of_window(&window);
        assert_eq!(cases.len(), 6);
        DepthTrainer::new(config, cases).unwrap()
    };
    let mut taught = trainer(5.0, 0.0);
    let pass =
        |trainer: &DepthTrainer| trainer.pass(&DepthNetwork::for_training(&trainer.weights).unwrap(), 0);
    let (_, gradient) = pass(&taught);
    let length = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
    // A short way along the gradient changes the loss by as much.
    let mut moved = |by: f64| {
        let weights = taught.weights.values.clone();
        for (weight, g) in taught.weights.values.iter_mut().zip(&gradient) {
            *weight += (by * f64::from(*g) / length) as f32;
        }
        let (value, _) = pass(&taught);
        taught.weights.values = weights;
        value
    };
    let by = 1e-3;
    let found = (moved(by) - moved(-by)) / (2.0 * by);
    assert!((found / length - 1.0).abs() < 0.25, "{found} {length}");
    let mut untaught = trainer(0.0, 0.0);
    assert_eq!(untaught.step().unwrap().loss, 0.0);
    assert_eq!(untaught.weights().values, DepthWeights::initial(config(1).seed).values);
}

#[test]
fn any_number_of_threads_makes_the_same_weights() {
    let cache = tempfile::tempdir().unwrap();
    let window = scene_windows::simulated_window(SimulatedScene::Generated(Kind::Desk, 3), (96, 64)).unwrap();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let cases = cases(cache.path()).mixed_with(DepthCases::of_window(&window), 0.5);
            let mut trainer = DepthTrainer::new(config(3), cases).unwrap();
            for _ in 0..3 {
                trainer.step().unwrap();
            }
            trainer.weights().values
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn a_gradient_that_is_not_finite_skips_the_step() {
    let cache = tempfile::tempdir().unwrap();
    let mut cases = cases(cache.path());
    for item in &mut cases.items {
        let Item::View(view) = item else { panic!("a window") };
        view.spoil();
    }
    let mut trainer = DepthTrainer::new(config(3), cases).unwrap();
    let before = trainer.weights().values;
    assert!(trainer.step().unwrap().skipped);
    assert_eq!((trainer.steps(), trainer.skipped()), (1, 1));
    assert_eq!(trainer.weights().values, before);
}

#[test]
fn crops_are_parts_of_the_view_and_mirrored_ones_are_turned() {
    let cache = tempfile::tempdir().unwrap();
    let cases = cases(cache.path());
    let case = cases.views()[0];
    let whole = case.whole();
    let plain = case.crop((3, 2), (20, 16), false);
    let turned = case.crop((3, 2), (20, 16), true);
    assert_eq!(plain.inputs.size(), (40, 32));
    let sample = |crop: &Crop, x: usize, y: usize| {
        (crop.inputs.stereo()[y * 40 + x], crop.exact[y * 40 + x].to_bits())
    };
    for (x, y) in [(0, 0), (39, 0), (17, 31)] {
        let of_whole = (y + 4) * 96 + x + 6;
        assert_eq!(sample(&plain, x, y), (whole.inputs.stereo()[of_whole], whole.exact[of_whole].to_bits()));
        assert_eq!(sample(&plain, x, y), sample(&turned, 39 - x, y));
    }
    let confidence = |crop: &Crop| crop.inputs.stereo_confidence();
    let (plain, mut turned) = (confidence(&plain), confidence(&turned));
    turned.chunks_exact_mut(40).for_each(<[f32]>::reverse);
    assert_eq!(plain, turned);
}

#[test]
fn settings_out_of_range_and_files_that_are_damaged_are_named() {
    let cache = tempfile::tempdir().unwrap();
    for config in [
        DepthConfig { batch: 0, ..config(1) },
        DepthConfig { batch: 5000, ..config(1) },
        DepthConfig { crop: (3, 16), ..config(1) },
        DepthConfig { photometric: -1.0, ..config(1) },
        DepthConfig { agreement: f32::NAN, ..config(1) },
        DepthConfig { rates: Rates { clip: f32::NAN, ..Rates::default() }, ..config(1) },
    ] {
        assert!(matches!(config.check(), Err(Error::Setting { .. })), "{config:?}");
    }
    drop(cases(cache.path()));
    let file = std::fs::read_dir(cache.path()).unwrap().next().unwrap().unwrap().path();
    std::fs::write(&file, b"cut").unwrap();
    let scenes = [SimulatedScene::Generated(Kind::Room, 2), SimulatedScene::InTheWild(Kind::Desk, 3)];
    let error = DepthCases::open(&scenes, (96, 64), cache.path(), &|_, _| {}).err();
    assert!(matches!(error, Some(Error::CacheFile { .. })));
}
