use super::*;
use crate::adam::length;
use attn_head::{Kind, OUTPUTS, WIDTH};
use scene_windows::{Plan, SimulatedScene};
use sparsesplat::{Backbone, Predictor};

fn trainer(config: Config, cache: &Path) -> Trainer {
    trainer_on(Backbone::GivenDepth, (48, 32), config, cache)
}

fn trainer_on(backbone: Backbone, size: (usize, usize), config: Config, cache: &Path) -> Trainer {
    let plans = [Plan::simulated(SimulatedScene::Courtyard, size)];
    let predict = sparsesplat::Config { backbone, ..sparsesplat::Config::default() };
    let cases = Cases::open(&plans, &Predictor::new(predict).unwrap(), cache, &mut |_, _| {}).unwrap();
    Trainer::new(config, cases, Rasterizer::cpu()).unwrap()
}

fn default_predictor() -> Predictor {
    Predictor::new(sparsesplat::Config::default()).unwrap()
}

/// Weights along which a derivative is checked.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Along {
    /// All of them.
    All,
    /// Those of the last layer.
    LastLayer,
    /// All, while the last layer's that move, turn, size or fade Gaussians are 0.
    Colours,
}

/// The chain head, decoder, renderer, loss: its derivative against differences, along the derivative itself (where the slope is largest
/// against the rounding of the pictures).
#[test]
fn the_gradient_of_the_chain_is_that_of_differences() {
    let cache = tempfile::tempdir().unwrap();
    // Where two Gaussians change places the loss has a step that no derivative knows of: large ones, of which the median of pieces sees none,
    // and with pooling small ones in every piece. Its derivative, and the others' more closely, are checked where there are none, as long as
    // colours alone change.
    let cases = [
        (Kind::Attention, Along::LastLayer, 0.01),
        (Kind::Mlp, Along::All, 0.01),
        (Kind::EdgeConv, Along::All, 0.01),
        (Kind::Attention, Along::Colours, 0.005),
        (Kind::Mlp, Along::Colours, 0.005),
        (Kind::EdgeConv, Along::Colours, 0.005),
        (Kind::MaxPool, Along::Colours, 0.005),
    ];
    let alike = cases.map(|case| (case, Parametrisation::Correction));
    let of_all_numbers = ((Kind::Attention, Along::Colours, 0.005), Parametrisation::Paper);
    for ((head, along, tolerance), parametrisation) in alike.into_iter().chain([of_all_numbers]) {
        let config = Config {
            head,
            parametrisation,
            neighbours: 6,
            density: [0.02, 0.02],
            lambda: 0.1,
            direction: 0.1,
            ..Config::default()
        };
        let mut trainer = trainer(config, cache.path());
        // With the cut-offs of a normal rendering, footprints end in every piece, and the slopes are up to 5 % off.
        trainer.rendering =
            RenderSettings { alpha_min: 1e-6, transmittance_min: 1e-7, ..RenderSettings::default() };
        // Away from the start, where the last layer is 0 and hides the others.
        let recipe = Weights::recipe(trainer.net.config(), "chain").unwrap();
        trainer.weights = recipe.values.iter().map(|w| 0.5 * w).collect();
        // The last layer ends the weights: a row of 128 per output, and a bias for each.
        let (n, rows) = (trainer.weights.len(), OUTPUTS * WIDTH);
        let last = n - rows - OUTPUTS;
        let output = |i: usize| if i < last + rows { (i - last) / WIDTH } else { i - last - rows };
        let fixed = |i: usize| match along {
            Along::All => false,
            Along::LastLayer => i < last,
            Along::Colours => i >= last && !(8..35).contains(&output(i)),
        };
        if along == Along::Colours {
            (0..n).filter(|&i| fixed(i)).for_each(|i| trainer.weights[i] = 0.0);
        }
        let found = trainer.pass(0).unwrap();
        assert!(found.gaussians > 100 && found.loss.is_finite());
        let direction: Vec<f32> =
            found.gradient.iter().enumerate().map(|(i, g)| if fixed(i) { 0.0 } else { *g }).collect();
        let slope = length(&direction);
        assert!(slope > 0.0);
        let weights = trainer.weights.clone();
        let mut value = |by: f64| {
            let step = (by / slope) as f32;
            trainer.weights = weights.iter().zip(&direction).map(|(w, d)| w + step * d).collect();
            trainer.pass(0).unwrap().loss
        };
        let piece = 2e-4;
        let values: Vec<f64> = (-5..=6).map(|i| value(piece * (f64::from(i) - 0.5))).collect();
        let mut slopes: Vec<f64> = values.windows(2).map(|pair| (pair[1] - pair[0]) / piece).collect();
        slopes.sort_by(f64::total_cmp);
        let median = slopes[slopes.len() / 2];
        assert!(
            (median / slope - 1.0).abs() < tolerance,
            "{head:?} {along:?}: {slopes:?}, derivative {slope}"
        );
    }
}

/// Looks lower the loss of the views that they see, and a pass compares what they leave.
#[test]
fn gaussians_are_compared_after_the_looks() {
    let cache = tempfile::tempdir().unwrap();
    let config = Config { neighbours: 6, density: [0.1, 0.1], targets: 0, contexts: 6, ..Config::default() };
    let [none, one, two] = [1, 2, 3].map(|looks| {
        let trainer = trainer(Config { looks, ..config.clone() }, cache.path());
        let pass = trainer.pass(0).unwrap();
        assert!(length(&pass.gradient) > 0.0);
        let score = trainer.validate(&trainer.cases, 0.1, &mut |_| {}).unwrap();
        (pass.loss, score.psnr)
    });
    assert!(one.0 < 0.95 * none.0 && two.0 < one.0, "{none:?}, {one:?}, {two:?}");
    assert!(one.1 > none.1 + 0.1, "{none:?}, {one:?}, {two:?}");
}

#[test]
fn what_colours_change_by_direction_is_held_down() {
    let cache = tempfile::tempdir().unwrap();
    let loss = |direction| {
        let config = Config { neighbours: 6, density: [0.02, 0.02], direction, ..Config::default() };
        let mut trainer = trainer(config, cache.path());
        let untrained = trainer.pass(0).unwrap().loss;
        trainer.weights = Weights::recipe(trainer.net.config(), "chain").unwrap().values;
        [untrained, trainer.pass(0).unwrap().loss]
    };
    let [none, one, two] = [0.0, 1.0, 2.0].map(loss);
    assert!(none[0] == one[0] && one[0] == two[0], "the closed form's colours are the same from everywhere");
    let (once, twice) = (one[1] - none[1], two[1] - none[1]);
    assert!(once > 1e-3 && (twice / once - 2.0).abs() < 1e-3, "{once} {twice}");
}

#[test]
fn what_is_not_finite_is_skipped_and_counted() {
    let cache = tempfile::tempdir().unwrap();
    let mut trainer = trainer(Config { density: [0.02, 0.02], batch: 1, ..Config::default() }, cache.path());
    let sound = trainer.weights.clone();
    trainer.weights[7] = f32::NAN;
    let broken = trainer.weights.clone();
    let record = trainer.step().unwrap();
    assert!(record.skipped && trainer.skipped() == 1 && trainer.steps() == 1);
    assert!(trainer.weights.iter().zip(&broken).all(|(a, b)| a.to_bits() == b.to_bits()));
    trainer.weights = sound;
    assert!(!trainer.step().unwrap().skipped);
    assert_eq!((trainer.skipped(), trainer.steps(), trainer.adam.updates), (1, 2, 1));
}

/// On one process too; `cargo xtask mpi-test` runs this on two ranks.
#[cfg(feature = "mpi")]
#[test]
fn what_is_not_finite_on_one_rank_is_skipped_on_all() {
    let cache = tempfile::tempdir().unwrap();
    let ranks = Arc::new(Ranks::of_mpi().unwrap());
    let config = Config { density: [0.02, 0.02], batch: 2, ..Config::default() };
    let mut trainer = trainer(config, cache.path()).on_ranks(Arc::clone(&ranks)).unwrap();
    assert!(!trainer.step().unwrap().skipped);
    let sound = trainer.weights.clone();
    // Of the last rank alone.
    if ranks.rank() + 1 == ranks.count() {
        trainer.weights[7] = f32::NAN;
    }
    let record = trainer.step().unwrap();
    assert!(record.skipped && !record.loss.is_finite() && trainer.skipped() == 1, "{record:?}");
    let changed = trainer.weights.iter().zip(&sound).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    assert_eq!(changed, usize::from(ranks.rank() + 1 == ranks.count()));
    trainer.weights = sound;
    assert!(!trainer.step().unwrap().skipped);
    trainer.agree().unwrap();
    // Ranks that would not end with the same weights are told before their next step.
    if ranks.count() > 1 {
        trainer.adam.updates += ranks.rank();
        trainer.agreed = false;
        assert!(matches!(trainer.step(), Err(Error::RanksDiffer)));
    }
}

#[test]
fn weights_do_not_depend_on_the_number_of_ranks() {
    let cache = tempfile::tempdir().unwrap();
    let config = Config { density: [0.02, 0.03], neighbours: 4, batch: 3, ..Config::default() };
    let trained = |count: usize| {
        // One makes the files of the cache that the others read.
        let trainers: Vec<Trainer> = Ranks::of_threads(count)
            .into_iter()
            .map(|ranks| trainer(config.clone(), cache.path()).on_ranks(Arc::new(ranks)).unwrap())
            .collect();
        std::thread::scope(|scope| {
            let run = |mut trainer: Trainer| {
                let records: Vec<Record> = (0..2).map(|_| trainer.step().unwrap()).collect();
                let figures: Vec<_> = records.iter().map(|r| (r.loss, r.psnr, r.gaussians)).collect();
                (trainer.weights, figures)
            };
            let threads: Vec<_> =
                trainers.into_iter().map(|trainer| scope.spawn(move || run(trainer))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
        })
    };
    let alone = trained(1).remove(0);
    for count in [2, 3] {
        for (rank, (weights, figures)) in trained(count).into_iter().enumerate() {
            assert_eq!(weights, alone.0, "rank {rank} of {count}");
            for (found, expected) in figures.iter().zip(&alone.1) {
                let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b.abs();
                assert!(near(found.0, expected.0) && near(found.1, expected.1) && found.2 == expected.2);
            }
        }
    }
}

#[test]
fn ranks_that_do_different_things_are_told() {
    let cache = tempfile::tempdir().unwrap();
    let errors: Vec<_> = Ranks::of_threads(2)
        .into_iter()
        .map(|ranks| {
            let config = Config { seed: ranks.rank() as u64, ..Config::default() };
            trainer(config, cache.path()).on_ranks(Arc::new(ranks)).unwrap()
        })
        .map(|mut trainer| std::thread::spawn(move || trainer.step().unwrap_err()))
        .collect();
    for error in errors {
        assert!(matches!(error.join().unwrap(), Error::RanksDiffer));
    }
    let many = Arc::new(Ranks::of_threads(3).remove(0));
    let refused = trainer(Config::default(), cache.path()).on_ranks(many);
    assert!(matches!(refused, Err(Error::IdleRanks { ranks: 3, batch: 2 })));
}

#[test]
fn an_untrained_head_is_the_closed_form() {
    let cache = tempfile::tempdir().unwrap();
    let trainer = trainer(Config::default(), cache.path());
    let score = trainer.validate(&trainer.cases, 0.05, &mut |_| {}).unwrap();
    assert!((score.psnr - score.psnr_closed_form).abs() < 1e-6, "{score:?}");
    assert!(score.psnr > 10.0, "{score:?}");
}

#[test]
fn a_run_that_is_resumed_ends_with_the_same_weights() {
    let folder = tempfile::tempdir().unwrap();
    let config = Config { steps: 4, density: [0.02, 0.05], ..Config::default() };
    let mut unbroken = trainer(config.clone(), folder.path());
    while unbroken.steps() < 4 {
        unbroken.step().unwrap();
    }
    let checkpoint = folder.path().join("checkpoint.safetensors");
    for _ in 0..2 {
        let mut run = trainer(config.clone(), folder.path());
        if checkpoint.exists() {
            run.resume(&checkpoint).unwrap();
        }
        for _ in 0..2 {
            run.step().unwrap();
        }
        run.save(&checkpoint).unwrap();
    }
    let mut resumed = trainer(config.clone(), folder.path());
    resumed.resume(&checkpoint).unwrap();
    assert_eq!((resumed.steps(), &resumed.weights), (4, &unbroken.weights));
    assert_ne!(resumed.weights, trainer(config.clone(), folder.path()).weights, "something was learnt");

    let mut other = trainer(Config { seed: 1, ..config }, folder.path());
    assert!(matches!(other.resume(&checkpoint), Err(Error::OtherRun { what: "configuration", .. })));
    let bytes = std::fs::read(&checkpoint).unwrap();
    std::fs::write(&checkpoint, &bytes[..bytes.len() / 2]).unwrap();
    assert!(matches!(other.resume(&checkpoint), Err(Error::Checkpoint { .. })));
}

/// Of a corrector's run with a window's refined scene made anew after every second pass: resumed after the first, and at a new scene.
#[test]
fn a_corrector_is_trained_on_refined_scenes_and_resumed_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let config = Config {
        head: Kind::Grid,
        refined: vec![2, 0],
        reuse: 2,
        batch: 1,
        density: [0.05, 0.05],
        ..Config::default()
    };
    let trainer = |config| trainer_on(Backbone::default(), (96, 64), config, folder.path());
    let mut unbroken = trainer(config.clone());
    // Untrained it changes nothing, and what it is held against is the refined scene.
    let score = unbroken.validate(&unbroken.cases, 0.05, &mut |_| {}).unwrap();
    assert!((score.psnr - score.psnr_closed_form).abs() < 1e-6, "{score:?}");
    let head = trainer(Config { refined: Vec::new(), ..config.clone() });
    let of_head = head.validate(&head.cases, 0.05, &mut |_| {}).unwrap();
    assert!(score.psnr > of_head.psnr + 0.5, "{score:?}, closed form {of_head:?}");
    let mut weights = Vec::new();
    for step in 0..3 {
        unbroken.step().unwrap();
        assert_eq!(unbroken.scenes.generations(), [step / 2]);
        weights.push(unbroken.weights.clone());
    }
    assert_ne!(weights[0], weights[2], "something was learnt");
    let checkpoint = folder.path().join("checkpoint.safetensors");
    for (step, expected) in weights.iter().enumerate() {
        let mut run = trainer(config.clone());
        if step > 0 {
            run.resume(&checkpoint).unwrap();
        }
        run.step().unwrap();
        assert_eq!(&run.weights, expected, "step {step}");
        run.save(&checkpoint).unwrap();
    }
    // Those of a head may be a beginning, but not the other way round.
    let mut narrow = trainer(Config { refined: Vec::new(), ..config });
    unbroken.start_from(&[("head".to_owned(), narrow.weights())]).unwrap();
    let refused = narrow.start_from(&[("corrector".to_owned(), unbroken.weights())]);
    assert!(matches!(refused, Err(Error::OtherHead { .. })));
}

#[test]
fn a_run_may_begin_with_the_weights_of_another() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = trainer(Config { density: [0.02, 0.02], batch: 1, ..Config::default() }, folder.path());
    first.step().unwrap();
    let path = folder.path().join("weights.safetensors");
    first.weights().write(&path).unwrap();
    let mut second = trainer(Config { seed: 5, ..Config::default() }, folder.path());
    let drawn = second.weights.clone();
    second.start_from(&[]).unwrap();
    assert_eq!(second.weights, drawn);
    let named = |weights| ("earlier".to_owned(), weights);
    second.start_from(&[named(Weights::read(&path).unwrap())]).unwrap();
    assert_eq!(second.weights, first.weights);
    let drawn = Weights { values: drawn, ..first.weights() };
    second.start_from(&[named(first.weights()), named(drawn.clone())]).unwrap();
    for ((mean, a), b) in second.weights.iter().zip(&first.weights).zip(&drawn.values) {
        assert_eq!(*mean, ((f64::from(*a) + f64::from(*b)) / 2.0) as f32);
    }
    // Half of what is added by direction: those outputs halve, the others stay.
    let recipe =
        Weights { values: Weights::recipe(second.net.config(), "chain").unwrap().values, ..first.weights() };
    let outputs = |keep_direction| {
        let mut run = trainer(Config { keep_direction, ..Config::default() }, folder.path());
        run.start_from(&[named(recipe.clone())]).unwrap();
        let case = run.cases.read(0).unwrap();
        let anchored = anchored(&run.config, &case, 0.02, 0).unwrap();
        let inputs =
            anchored.inputs(run.config.head, &case.geometry.views, &anchored.feedback(true).unwrap());
        attn_head::Head::new(run.weights()).unwrap().run(&inputs.as_inputs()).unwrap()
    };
    let (all, half) = (outputs(1.0), outputs(0.5));
    for (i, (all, half)) in all.iter().zip(&half).enumerate() {
        let expected = if (11..35).contains(&(i % OUTPUTS)) { 0.5 * all } else { *all };
        assert!(all.abs() > 0.0 && (half - expected).abs() <= 1e-6 * all.abs(), "{i}: {half} {expected}");
    }
    // Of a run without feedback; never the other way round.
    let config = second.net.config();
    let of_features = |geometry| {
        let config = attn_head::Config { geometry, ..config };
        Weights { metadata: first.weights().metadata, ..Weights::recipe(config, "chain").unwrap() }
    };
    let narrow = of_features(geometry_features(false));
    second.start_from(&[named(narrow.clone())]).unwrap();
    assert_eq!(second.weights, narrow.widened(config.geometry).unwrap().values);
    let mut without = trainer(Config { feedback: false, ..Config::default() }, folder.path());
    assert!(matches!(without.start_from(&[named(first.weights())]), Err(Error::OtherHead { .. })));
    without.start_from(&[named(narrow.clone())]).unwrap();
    assert_eq!(without.weights, narrow.values);
    assert!(matches!(second.start_from(&[named(of_features(3))]), Err(Error::OtherHead { .. })));
    let mut other = trainer(Config { neighbours: 3, ..Config::default() }, folder.path());
    let error = other.start_from(&[named(first.weights())]).unwrap_err();
    assert!(matches!(&error, Error::OtherHead { weights, .. } if weights == "earlier"), "{error}");
}

#[test]
fn a_file_of_the_cache_that_is_cut_off_or_gone_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let trainer = trainer(Config::default(), folder.path());
    let files = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
    let (views, geometry): (Vec<_>, Vec<_>) =
        files.partition(|path| path.to_string_lossy().ends_with(".views.safetensors"));
    for file in [&views[0], &geometry[0]] {
        let bytes = std::fs::read(file).unwrap();
        for length in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(file, &bytes[..length]).unwrap();
            let error = trainer.cases.read(0).unwrap_err();
            assert!(error.to_string().contains(&file.display().to_string()), "{length}: {error}");
        }
        std::fs::write(file, bytes).unwrap();
    }
    // What the backbone says can be asked for again, a view cannot.
    std::fs::remove_file(&geometry[0]).unwrap();
    assert!(trainer.cases.read(0).is_ok());
    std::fs::remove_file(&views[0]).unwrap();
    assert!(matches!(trainer.cases.read(0), Err(Error::CacheFile { .. })));
    let empty = Cases::open(&[], &default_predictor(), folder.path(), &mut |_, _| {});
    assert!(matches!(empty, Err(Error::NoWindows)));
}

#[test]
fn a_window_without_enough_for_the_backbone_is_named_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    // Of so small pictures no depth range can be estimated.
    let [tiny, good] = [(8, 6), (96, 64)].map(|size| Plan::simulated(SimulatedScene::Courtyard, size));
    let open = |plans: &[Plan]| {
        let mut told = Vec::new();
        let on_case = &mut |name: &str, why: Option<&scene_windows::Error>| {
            told.push((name.to_owned(), why.map(ToString::to_string)));
        };
        (Cases::open(plans, &default_predictor(), folder.path(), on_case), told)
    };
    let (both, told) = open(&[tiny.clone(), good.clone()]);
    let (one, _) = open(&[good]);
    let (both, one) = (both.unwrap(), one.unwrap());
    assert_eq!((both.len(), both.sha256()), (1, one.sha256()));
    let [(first, Some(why)), (second, None)] = &told[..] else { panic!("{told:?}") };
    assert_eq!((&first[..], &second[..]), ("courtyard/0", "courtyard/0"));
    assert!(why.contains("depth range"), "{why}");
    assert!(matches!(open(&[tiny]).0, Err(Error::Windows(_))));
}

#[test]
fn sources_are_drawn_by_their_shares_and_scenes_alike() {
    let folder = tempfile::tempdir().unwrap();
    let open = |size| {
        let plans = [Plan::simulated(SimulatedScene::Courtyard, size)];
        let config = sparsesplat::Config { backbone: Backbone::GivenDepth, ..sparsesplat::Config::default() };
        Cases::open(&plans, &Predictor::new(config).unwrap(), folder.path(), &mut |_, _| {}).unwrap()
    };
    let (one, other) = (open((24, 16)), open((48, 32)));
    assert!((0..50).all(|pass| one.drawn(3, pass) == 0));
    let both = one.clone().mixed_with(other.clone(), 0.25);
    assert_eq!((both.len(), both.read(1).unwrap().context[0].image().width()), (2, 48));
    let drawn = (0..4000).filter(|&pass| both.drawn(3, pass) == 1).count();
    assert!((900..1100).contains(&drawn), "{drawn}");
    // Order and share decide what a run makes.
    let turned = other.clone().mixed_with(one.clone(), 0.25);
    let seldom = one.clone().mixed_with(other, 0.3);
    let hashes = [&one, &both, &turned, &seldom].map(Cases::sha256);
    assert!((1..4).all(|i| !hashes[..i].contains(&hashes[i])), "{hashes:?}");
    // Of three sources the shares are those of the whole.
    let three = both.mixed_with(one, 0.5);
    let mut counts = [0; 3];
    (0..4000).for_each(|pass| counts[three.drawn(5, pass)] += 1);
    assert!((1350..1650).contains(&counts[0]) && (400..600).contains(&counts[1]), "{counts:?}");
}

#[test]
fn weights_say_what_their_outputs_mean_and_which_neighbours_they_saw() {
    let folder = tempfile::tempdir().unwrap();
    let usual = Config { steps: 1, batch: 1, neighbours: 6, feedback: false, ..Config::default() };
    let other = Config { parametrisation: Parametrisation::Paper, covisible: 3, ..usual.clone() };
    let [plain, paper] = [usual, other].map(|config| trainer(config, folder.path()));
    assert_eq!(plain.weights().metadata.keys().collect::<Vec<_>>(), [FEATURES]);
    let metadata = paper.weights().metadata;
    assert_eq!((&metadata[PARAMETRISATION][..], &metadata[COVISIBLE][..]), ("paper", "3"));
    // Whoever uses them need not know: the pass takes both from the weights.
    let file = folder.path().join("paper.safetensors");
    paper.weights().write(&file).unwrap();
    let config = sparsesplat::Config {
        backbone: Backbone::GivenDepth,
        head: sparsesplat::Head::Weights(file),
        neighbours: 6,
        ..sparsesplat::Config::default()
    };
    let predictor = Predictor::new(config).unwrap();
    let case = paper.cases.read(0).unwrap();
    let made = predictor.predict_from(&case.context, &case.geometry, &mut |_| {}).unwrap();
    assert_eq!(made.gaussians.sh_degree(), 2, "made by the head");
    // A run of the other kind does not begin with them.
    let mut plain = plain;
    let error = plain.start_from(&[("paper".to_owned(), paper.weights())]).unwrap_err();
    assert!(error.to_string().contains("covisible"), "{error}");
}

#[test]
fn settings_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let cases = trainer(Config::default(), folder.path()).cases;
    let rates = crate::Rates { learning_rate: f64::NAN, ..Config::default().rates };
    let endless = crate::Rates { clip: f32::INFINITY, ..Config::default().rates };
    for config in [
        Config { density: [0.0, 0.1], ..Config::default() },
        Config { density: [0.2, 0.1], ..Config::default() },
        Config { density: [0.1, f64::NAN], ..Config::default() },
        Config { batch: 0, ..Config::default() },
        Config { targets: 0, contexts: 0, ..Config::default() },
        Config { lambda: f32::NAN, ..Config::default() },
        Config { depth_error: 0.3, ..Config::default() },
        Config { recolour: 1.1, ..Config::default() },
        Config { direction: -0.1, ..Config::default() },
        Config { direction: f32::INFINITY, ..Config::default() },
        Config { keep_direction: f32::NAN, ..Config::default() },
        Config { rates: endless, ..Config::default() },
        Config { targets: usize::MAX, contexts: 1, batch: 0, ..Config::default() },
        Config { rates, ..Config::default() },
    ] {
        let refused = Trainer::new(config.clone(), cases.clone(), Rasterizer::cpu());
        assert!(matches!(refused, Err(Error::Setting { .. })), "{config:?}");
    }
}
