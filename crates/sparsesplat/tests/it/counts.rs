use crate::{COURTYARD, check_prediction, given_depth, plane_sweep, positions, run};
use glam::DVec3;
use gs_scene::{DepthMap, Image, View};
use sparsesplat::{Allocation, Budget, Config, Prediction, Predictor, Sampler, Stage};

/// The count is the budget, and the shell takes at most its share of it.
fn check_exact(views: &[View], config: &Config, n: usize) -> Prediction {
    let prediction = run(views, &Config { budget: Budget::Gaussians(n), ..config.clone() });
    assert_eq!(prediction.counts.total, n);
    assert!(prediction.counts.shell as f64 <= 0.08 * n as f64, "{:?}", prediction.counts);
    let draws = !matches!(config.allocation, Allocation::Merged | Allocation::VoxelAligned);
    assert_eq!(prediction.tau.is_some_and(|tau| tau.is_finite() && tau > 0.0), draws);
    prediction
}

#[test]
fn the_budget_is_met_exactly_by_every_allocation_and_backbone() {
    let views = &COURTYARD.0;
    for allocation in [Allocation::Entropy, Allocation::Laplacian, Allocation::Random] {
        for sampler in [Sampler::Fixed, Sampler::Systematic] {
            check_exact(views, &Config { allocation, sampler, ..given_depth(1) }, 3_001);
        }
    }
    for n in [1, 2, 10, 100, 20_000] {
        check_exact(views, &given_depth(1), n);
    }
    check_exact(&views[..3], &plane_sweep(1), 5_000);
    for allocation in [Allocation::Merged, Allocation::VoxelAligned] {
        for n in [1, 100, 3_001, 20_000] {
            check_exact(views, &Config { allocation, ..given_depth(1) }, n);
        }
        check_exact(&views[..3], &Config { allocation, ..plane_sweep(1) }, 5_000);
    }
}

#[test]
fn the_shell_can_be_left_out_and_is_there_when_the_budget_allows() {
    let views = &COURTYARD.0;
    let with = check_exact(views, &given_depth(1), 6_000);
    let without = check_exact(views, &Config { far_shell: false, ..given_depth(1) }, 6_000);
    assert!(with.counts.shell > 100, "{:?}", with.counts);
    assert_eq!(without.counts.shell, 0);
    // The shell comes last, and begins with the first view's, behind the scene.
    let first = positions(&with.gaussians)[6_000 - with.counts.shell];
    let depth = views[0].camera().to_camera(DVec3::from(first.map(f64::from))).z;
    assert!((0.999..4.0).contains(&(depth / with.depth_range.1)), "{depth}, range {:?}", with.depth_range);
}

#[test]
fn pixels_that_stereo_filled_in_are_drawn_less_often() {
    let views = &COURTYARD.0[..3];
    let drawn = |filled_weight: f32| {
        let (allocation, sampler) = (Allocation::Random, Sampler::Systematic);
        let config = Config { allocation, sampler, filled_weight, far_shell: false, ..plane_sweep(1) };
        run(views, &Config { budget: Budget::Tau(1.0), ..config })
    };
    let all = drawn(1.0);
    let usable = all.geometry.iter().flat_map(|view| &view.confidence).filter(|&&c| c > 0.0).count();
    let confirmed = all.geometry.iter().flat_map(|view| &view.confidence).filter(|&&c| c >= 0.5).count();
    assert!(confirmed > 1000 && usable > confirmed + 1000, "{confirmed} of {usable}");
    assert_eq!((all.counts.total, drawn(0.0).counts.total), (usable, confirmed));
    let half = drawn(0.5).counts.total as f64;
    let expected = confirmed as f64 + 0.5 * (usable - confirmed) as f64;
    assert!((half - expected).abs() < 3.0 * views.len() as f64, "{half}, expected {expected}");
    // Measured depth is never filled in.
    let measured = |filled_weight| run(views, &Config { filled_weight, ..given_depth(500) }).gaussians;
    assert!(measured(0.0) == measured(1.0));
}

#[test]
fn smooth_pixels_are_drawn_less_often() {
    // A ramp, whose Laplacian is 0, with a square of 15x15 pixels that is some grey levels brighter, all at one depth.
    let camera = *COURTYARD.0[0].camera();
    let (width, height) = (camera.width(), camera.height());
    let inside = |x: usize, y: usize| x.abs_diff(width / 2) < 8 && y.abs_diff(height / 2) < 8;
    let square = |levels: usize| {
        let grey = |pixel: usize| {
            let (x, y) = (pixel % width, pixel / width);
            (x + if inside(x, y) { levels } else { 0 }) as f32 / 255.0
        };
        let pixels = (0..width * height).flat_map(|pixel| [grey(pixel); 3]).collect();
        let depth = DepthMap::new(width, height, vec![5.0; width * height]).unwrap();
        View::new("square", Image::new(width, height, pixels).unwrap(), camera, Some(depth)).unwrap()
    };
    let drawn = |levels: usize, smooth_weight: f32, tau: f64| {
        let (sampler, budget) = (Sampler::Systematic, Budget::Tau(tau));
        let config = Config { sampler, smooth_weight, budget, far_shell: false, ..given_depth(1) };
        run(&[square(levels)], &config).counts.total as f64
    };
    // The Laplacian is not 0 on both sides of the edge, and where the picture is mirrored, left and right.
    let detailed = (56 + 60 + 2 * height) as f64;
    assert_eq!(drawn(40, 0.0, 1e6), detailed);
    assert_eq!(drawn(40, 0.1, 1e6), (width * height) as f64);
    // Below a probability of 1 the factor is a line from the weight to 1.
    let [none, half, full] = [0.0, 0.5, 1.0].map(|weight| drawn(40, weight, 1.5));
    assert!((half - (none + full) / 2.0).abs() < 2.0, "{none}, {half}, {full}");
    // On the edge it grows with the Laplacian up to 64 levels. Corners, which have twice as much, and the mirrored border are some 5 of the 85.
    let [lower, below, at, above] = [32, 60, 64, 128].map(|levels| drawn(levels, 0.0, 1.5));
    assert!((at - above).abs() < 2.0 && below + 3.0 < at, "{below}, {at}, {above}");
    assert!((lower - at / 2.0).abs() < 5.0, "{lower}, {at}");
    // The rule belongs to the entropy.
    let random = |smooth_weight| {
        let config = Config { allocation: Allocation::Random, smooth_weight, ..given_depth(500) };
        run(&COURTYARD.0, &config).gaussians
    };
    assert!(random(0.0) == random(1.0));
}

#[test]
fn a_fused_surface_has_as_many_gaussians_as_if_one_view_saw_it() {
    let views = &COURTYARD.0[..3];
    let (allocation, sampler) = (Allocation::Random, Sampler::Systematic);
    let config = Config { allocation, sampler, fuse: true, far_shell: false, ..given_depth(1) };
    let fused = run(views, &Config { budget: Budget::Tau(1.0), ..config.clone() });
    let surfaces = depth_backbone::fuse(views, &fused.geometry).unwrap();
    let (mut expected, mut shared) = (0.0, 0);
    for (view, surface) in fused.geometry.iter().zip(&surfaces) {
        for (&depth, &by) in view.depth.data().iter().zip(&surface.shared_by) {
            expected += if depth > 0.0 { 1.0 / (1.0 + f64::from(by)) } else { 0.0 };
            shared += usize::from(by > 0);
        }
    }
    assert!(shared > 5000, "{shared}");
    let found = fused.counts.total as f64;
    assert!((found - expected).abs() < 3.0 * views.len() as f64, "{found}, expected {expected}");
    check_exact(views, &config, 2_000);
    let apart = run(views, &Config { fuse: false, ..config.clone() }).gaussians;
    assert!(apart != run(views, &config).gaussians);
}

#[test]
fn more_than_there_are_pixels_is_every_usable_pixel() {
    let views = &COURTYARD.0[..2];
    let usable = views.iter().map(|v| v.depth().unwrap().data().iter().filter(|&&d| d > 0.0).count());
    let usable: Vec<usize> = usable.collect();
    for n in [1_000_000, usize::MAX] {
        let prediction = run(views, &given_depth(n));
        assert_eq!(prediction.counts.per_view, usable, "budget {n}");
    }
    let of = |allocation, n| run(views, &Config { allocation, ..given_depth(n) });
    let aligned = of(Allocation::PixelAligned, 7);
    assert_eq!((&aligned.counts.per_view, aligned.tau), (&usable, None));
    // With nothing to be merged or averaged the baselines are the pixel-aligned set, voxels drawn wider.
    assert!(of(Allocation::Merged, usize::MAX).gaussians == aligned.gaussians);
    let voxels = of(Allocation::VoxelAligned, usize::MAX);
    assert_eq!(voxels.counts, aligned.counts);
    let (voxels, aligned) = (positions(&voxels.gaussians), positions(&aligned.gaussians));
    let pairs = voxels.iter().flatten().zip(aligned.iter().flatten());
    let farthest = pairs.fold(0.0_f32, |farthest, (a, b)| farthest.max((a - b).abs()));
    assert!(farthest < 1e-3, "{farthest}");
}

#[test]
fn bernoulli_varies_around_the_budget() {
    let n = 4_000;
    let count = |seed| {
        let config = Config { sampler: Sampler::Bernoulli, seed, far_shell: false, ..given_depth(n) };
        run(&COURTYARD.0, &config).counts.total
    };
    let counts = [0, 1, 2].map(count);
    // The variance of a sum of independent draws with mean n is at most n.
    let five_sigma = 5.0 * (n as f64).sqrt();
    assert!(counts.iter().all(|&count| (count as f64 - n as f64).abs() < five_sigma), "{counts:?}");
    assert!(counts.iter().any(|&count| count != counts[0]), "{counts:?}");
}

#[test]
fn the_tau_of_a_budget_gives_its_count_and_the_shell_comes_on_top() {
    let n = 4_000;
    let bare = Config { far_shell: false, ..given_depth(n) };
    let tau = run(&COURTYARD.0, &bare).tau.unwrap();
    let by_tau = Config { budget: Budget::Tau(tau), ..bare };
    let prediction = run(&COURTYARD.0, &by_tau);
    assert!(prediction.counts.total.abs_diff(n) <= 1, "{:?}", prediction.counts);
    assert_eq!(prediction.tau, Some(tau));
    let backed = run(&COURTYARD.0, &Config { far_shell: true, ..by_tau });
    assert_eq!(backed.counts.per_view, prediction.counts.per_view);
    assert!(backed.counts.shell > 0);
}

#[test]
fn stages_are_announced_in_order_and_timed() {
    let mut stages = Vec::new();
    let config = given_depth(2_000);
    let prediction = Predictor::new(config.clone())
        .and_then(|predictor| predictor.predict(&COURTYARD.0, &mut |stage| stages.push(stage)))
        .unwrap();
    check_prediction(&COURTYARD.0, &prediction, &config);
    let expected = [
        Stage::Backbone,
        Stage::Exposure,
        Stage::Shell,
        Stage::Sampling,
        Stage::Backproject,
        Stage::Knn,
        Stage::Head,
        Stage::Decode,
    ];
    assert_eq!(stages, expected);
    let s = prediction.seconds;
    assert!(
        expected.iter().all(|&stage| stage == Stage::Shell || s[stage] > 0.0) && s[Stage::Feedback] == 0.0,
        "{s:?}"
    );
}
