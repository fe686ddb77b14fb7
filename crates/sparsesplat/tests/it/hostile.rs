use crate::{COURTYARD, check_prediction, given_depth, photograph, plane_sweep, predict, run};
use gs_scene::{Camera, DepthMap, Gaussians, LOG_SCALE, View};
use scene_sim::{Traced, demo_scene, lens};
use sparsesplat::{Allocation, Backbone, Budget, Config, DepthRange, Error};

const ALL: [Allocation; 6] = [
    Allocation::Entropy,
    Allocation::Laplacian,
    Allocation::Random,
    Allocation::PixelAligned,
    Allocation::Merged,
    Allocation::VoxelAligned,
];
/// One of each kind that keeps to a count.
const BY_COUNT: [Allocation; 3] = [Allocation::Entropy, Allocation::Merged, Allocation::VoxelAligned];

fn check_error(views: &[View], config: &Config, expected: impl Fn(&Error) -> bool) {
    match predict(views, config) {
        Ok(prediction) => panic!("{:?}, expected an error", prediction.counts),
        Err(error) => assert!(expected(&error), "{error}"),
    }
}

fn is_backbone(error: &Error) -> bool {
    matches!(error, Error::Backbone(_))
}

fn is_sampling(error: &Error) -> bool {
    matches!(error, Error::Sampling(_))
}

fn with_depth(view: &View, depth: impl Fn(usize) -> f32) -> View {
    let n = view.image().width() * view.image().height();
    let depth =
        DepthMap::new(view.image().width(), view.image().height(), (0..n).map(depth).collect()).unwrap();
    View::new(view.name(), view.image().clone(), *view.camera(), Some(depth)).unwrap()
}

#[test]
fn a_budget_of_nothing() {
    for config in [given_depth(0), plane_sweep(0)] {
        check_error(&COURTYARD.0, &config, |e| matches!(e, Error::EmptyBudget));
    }
    for tau in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        check_error(&COURTYARD.0, &Config { budget: Budget::Tau(tau), ..given_depth(1) }, is_sampling);
    }
    for weight in [f32::NAN, -0.1, 1.1] {
        check_error(&COURTYARD.0, &Config { filled_weight: weight, ..plane_sweep(1) }, |e| {
            matches!(e, Error::PixelWeight { pixels: "filled-in", .. })
        });
        check_error(&COURTYARD.0, &Config { smooth_weight: weight, ..plane_sweep(1) }, |e| {
            matches!(e, Error::PixelWeight { pixels: "smooth", .. })
        });
    }
    for allocation in [Allocation::Merged, Allocation::VoxelAligned] {
        check_error(&COURTYARD.0, &Config { allocation, ..given_depth(0) }, |e| {
            matches!(e, Error::EmptyBudget)
        });
        let by_tau = Config { allocation, budget: Budget::Tau(2.0), ..given_depth(1) };
        check_error(&COURTYARD.0, &by_tau, |e| matches!(e, Error::NothingDrawn { tau: 2.0 }));
    }
}

#[test]
fn too_few_views_for_the_backbone() {
    check_error(&[], &plane_sweep(100), is_backbone);
    check_error(&COURTYARD.0[..1], &plane_sweep(100), is_backbone);
    check_error(&[], &given_depth(100), |e| !matches!(e, Error::EmptyBudget));
    assert_eq!(run(&COURTYARD.0[..1], &given_depth(100)).counts.total, 100);
}

#[test]
fn no_depth_and_no_range() {
    let bare = |view: &View| View::new(view.name(), view.image().clone(), *view.camera(), None).unwrap();
    let views: Vec<View> = COURTYARD.0.iter().map(bare).collect();
    check_error(&views, &given_depth(100), is_backbone);
    let empty: Vec<View> = COURTYARD.0.iter().map(|view| with_depth(view, |_| 0.0)).collect();
    check_error(&empty, &given_depth(100), is_backbone);
    let inside_out = DepthRange::Known { near: 5.0, far: 2.0 };
    check_error(&COURTYARD.0, &Config { depth_range: inside_out, ..plane_sweep(100) }, is_backbone);
}

#[test]
fn a_pixel_that_is_not_finite_is_an_error_of_the_backbone() {
    let mut views = COURTYARD.0.clone();
    views[1].image_mut().data_mut()[70] = f32::NAN;
    check_error(&views, &plane_sweep(100), is_backbone);
}

#[test]
fn tiny_budgets_and_any_number_of_neighbours() {
    for neighbours in [0, 1, 500, usize::MAX] {
        for n in [1, 2, 10, 300] {
            assert_eq!(run(&COURTYARD.0, &Config { neighbours, ..given_depth(n) }).counts.total, n);
        }
        for allocation in [Allocation::Merged, Allocation::VoxelAligned] {
            // Few pixels: with all of them as neighbours of all, the memory would be theirs squared.
            let views: Vec<View> = COURTYARD.0[..2]
                .iter()
                .map(|view| with_depth(view, |i| if i % 37 == 0 { 4.0 } else { 0.0 }))
                .collect();
            for n in [1, 2, 10, 300] {
                let config = Config { neighbours, allocation, ..given_depth(n) };
                assert_eq!(run(&views, &config).counts.total, n, "{allocation:?}");
            }
        }
    }
}

#[test]
fn pictures_of_one_colour_and_single_measured_pixels() {
    for grey in [0.0, 0.5, 1.0] {
        let mut views = COURTYARD.0[..2].to_vec();
        views.iter_mut().for_each(|view| view.image_mut().data_mut().fill(grey));
        for allocation in ALL {
            let config = Config { allocation, ..given_depth(400) };
            match predict(&views, &config) {
                Ok(prediction) => check_prediction(&views, &prediction, &config),
                Err(error) => assert!(is_sampling(&error), "{allocation:?}: {error}"),
            }
        }
    }
    let lone: Vec<View> = COURTYARD.0[..2]
        .iter()
        .map(|view| with_depth(view, |i| if i == 8_000 { 4.0 } else { 0.0 }))
        .collect();
    for allocation in ALL {
        let config = Config { far_shell: false, allocation, ..given_depth(400) };
        assert_eq!(run(&lone, &config).counts.per_view, [1, 1], "{allocation:?}");
    }
}

#[test]
fn depth_with_deep_steps_and_of_extreme_scale() {
    let checkered = |i: usize| if (i / 3).is_multiple_of(2) { 0.1_f32 } else { 1e4 };
    let tiny = |i: usize| 1e-6 * (1 + i % 7) as f32;
    let huge = |i: usize| 1e7 * (1 + i % 7) as f32;
    for depth in [&checkered as &dyn Fn(usize) -> f32, &tiny, &huge] {
        let views: Vec<View> = COURTYARD.0[..2].iter().map(|view| with_depth(view, depth)).collect();
        for allocation in BY_COUNT {
            for n in [3, 700] {
                assert_eq!(run(&views, &Config { allocation, ..given_depth(n) }).counts.total, n);
            }
        }
    }
}

#[test]
fn a_few_gaussians_for_very_wide_pictures_stay_bounded() {
    let scene = Traced::new(&demo_scene()).unwrap();
    let widen = |view: &View| view.camera().with_intrinsics(lens(80, 60, 150.0)).unwrap();
    let cameras: Vec<Camera> = COURTYARD.0[..2].iter().map(widen).collect();
    let views = photograph(&scene, &cameras);
    for seed in 0..40 {
        let config = Config { seed, far_shell: false, ..given_depth(1 + seed as usize / 4) };
        let gaussians = run(&views, &config).gaussians;
        for row in gaussians.geometry().chunks_exact(Gaussians::GEOMETRY) {
            let widest = row[LOG_SCALE].iter().fold(0.0_f32, |widest, v| widest.max(v.exp()));
            assert!(widest < 1e3, "seed {seed}: {row:?}");
        }
    }
}

#[test]
fn a_camera_given_twice_and_cameras_in_one_place() {
    let twice = vec![COURTYARD.0[0].clone(); 3];
    for allocation in BY_COUNT {
        assert_eq!(
            run(&twice, &Config { allocation, ..given_depth(900) }).counts.total,
            900,
            "{allocation:?}"
        );
    }
    check_error(&twice, &Config { backbone: Backbone::default(), ..given_depth(900) }, |e| {
        matches!(e, Error::NoParallax { views: 3, .. })
    });
}

#[test]
fn views_from_one_place_are_refused_whatever_range_is_stated() {
    let scene = Traced::new(&demo_scene()).unwrap();
    let first = *COURTYARD.0[0].camera();
    let turned = |angle: f64| {
        let by = glam::DMat3::from_rotation_y(angle) * first.rotation();
        Camera::new(*first.intrinsics(), by, -(by * first.position())).unwrap()
    };
    let views = photograph(&scene, &[turned(0.0), turned(0.1), turned(0.2)]);
    let stated = plane_sweep(1000);
    for config in [Config { depth_range: DepthRange::Estimate, ..stated.clone() }, stated] {
        check_error(&views, &config, |e| matches!(e, Error::NoParallax { views: 3, .. }));
    }
}
